"""Networks that find a person in pictures: landmarks, masks, normals.

MediaPipe's landmark networks, which pip fetches:

=======================  ==================================================================
``watch``                landmarks and silhouette of one person in a whole video: start here
``person_tracker``       detects people, and follows one of them
``body_landmarks``       landmarks and silhouette of the body
``hand_face_landmarks``  landmarks of both hands and of the face
``turned_square``        the rotated square of a picture that a network sees
``mediapipe``            the files of these networks, and how they are run
=======================  ==================================================================

Networks whose files the user provides:

=======================  ==================================================================
``segment_anything``     the person's mask, by Segment Anything, prompted by poses
``normals``              the person's normals, by an ONNX file
=======================  ==================================================================
"""
