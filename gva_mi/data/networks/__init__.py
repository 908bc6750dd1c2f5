"""Networks that see a person in pictures.

MediaPipe's landmark networks, fetched once by pip (``weights``) and run by ai-edge-litert:

====================  ==================================================================
``watch``             one person's landmarks and silhouette in all pictures of a film
``person_tracker``    keeps to one person, though others walk past
``known_person``      what is remembered of a person
``person_detector``   finds the people of a picture
``body_landmarks``    the body's landmarks and silhouette
``hand_landmarks``    the landmarks of both hands, ``face_landmarks`` of the face
``seen_part``         a hand or a face, and how it is looked for
``turned_square``     the part of a picture that such a network sees
``tflite``            runs a network
====================  ==================================================================

Networks that users bring as files of their own:

====================  ==================================================================
``segment_anything``  the person's mask, by Segment Anything, prompted by the pose
``normals``           the person's normals, by an ONNX file
``crop``              cuts the person out for a network
====================  ==================================================================
"""
