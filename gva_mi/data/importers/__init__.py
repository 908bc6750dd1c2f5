"""Files of other programs, as poses of this one.

==================  ================================================================
``fields``          joints under everybody's names and shapes, as 55 rotations
``timeline``        frames that are missing, frame rates: rotations between rotations
``world``           which way is up, and turning that upright
``motions``         AMASS, AIST++ and the like, as driving poses
``tracks``          one person as an estimator saw them; who, which frames, which shape
``estimators``      WHAM, GVHMR, 4D-Humans, SMPLer-X: their files as tracks
``footage``         pictures and masks as people keep them
``prepare``         all of that as a folder that every step reads
==================  ================================================================
"""
