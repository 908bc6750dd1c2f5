"""Networks that see a person in pictures.

MediaPipe's landmark networks:

=======================  ==================================================================
``watch``                one person's landmarks and silhouette in all pictures of a video
``person_tracker``       finds people, and follows one of them
``body_landmarks``       the body's landmarks and silhouette
``hand_face_landmarks``  those of both hands and of the face
``turned_square``        the part of a picture that such a network sees
``mediapipe``            their files, fetched once by pip, and how they are run
=======================  ==================================================================

Networks that users bring as files of their own:

=======================  ==================================================================
``segment_anything``     the person's mask, by Segment Anything, prompted by the pose
``normals``              the person's normals, by an ONNX file
=======================  ==================================================================
"""
