"""The fit: minimise Eq. 9, and track poses through an avatar.

===============  ===================================================================
``train``        the training loop: start here
``options``      learning rates, schedule, and the options of the parts
``paper``        fit and refinement as the paper prints them: ``--preset paper``
``samples``      training frames, served one per step
``losses``       the loss (Eq. 9), and two optional terms
``backgrounds``  a render compared with a person on the same background
``perceptual``   perceptual distances, in the features of a network
``colors``       first colours, colours of unseen surfaces, and light
``poses``        poses and faces, given or trained along
``photometric``  tracking: poses fitted to the pictures through the avatar
``renders``      renders as 8-bit pictures, and cameras around a person
``web_page``     a page that plays the avatar in any browser
``run_folder``   the folder of a run, and how a fit resumes
===============  ===================================================================

Nothing is imported here: ``gva-mi doctor`` uses :mod:`gva_mi.fit.perceptual` also on machines where
Dr.Jit cannot be imported yet.
"""
