"""Studies: many synthetic subjects, and real videos before several cameras.

================  ==================================================================
``cases``         tuning and held-out cases
``videos``        their videos
``variants``      the ways to make an avatar that are compared
``engine``        cases x variants -> figures (:mod:`gva_mi.evaluate.figures`), resumable
``refine_study``  the study of refinement
``avatar_study``  the study of avatars
``relight``       the study of avatars in other light
``report``        tables and page of a study
``multiview``     stage 1 of one camera, against several calibrated cameras
================  ==================================================================

No step that refines or fits reads anything from here.
"""
