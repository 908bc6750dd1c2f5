"""Files of other programs, as poses of this one.

=====================  ===============================================================
``fields``             joints under everybody's names and shapes, as 55 rotations
``timeline``           frames that are missing, frame rates: rotations between rotations
``world``              which way is up, and turning that upright
``motions``            AMASS, AIST++ and the like, as driving poses
``estimated_motions``  the same of what estimators saw: in their world, or their camera's axes
``other_bodies``       parameters of MHR, refused by name
``tracks``             one person as an estimator saw them; who, which frames, which shape
``readings``           lenses, cameras and poses of their files, as tracks
``whole_videos``       estimators that write a file a video
``frame_files``        estimators that write a file a frame
``smplx_json``         OSX, NeuralAnnot, ExAvatar: JSON a frame
``estimators``         which of them wrote a file: WHAM, GVHMR, TRAM, PyMAF-X, SMPLify-X, ...
``recordings``         people with their pictures, masks and splits
``footage``            pictures and masks as people keep them
``hdf5``               arrays of HDF5 files that may be hostile
``lenses``             pictures without their lens's distortion
``people_snapshot``    People-Snapshot, and InstantAvatar's form of it
``multi_view``         ZJU-MoCap, EasyMocap, AvatarReX
``exavatar``           ExAvatar's frames, masks and SMPL-X
``other_views``        other cameras of these, as views that are held out
``neuman``             NeuMan's walks past a moving camera
``datasets``           which of these a folder is
``prompts``            where the person is, for a network that is told
``by_networks``        masks and normals that networks make
``prepare``            all of that as a folder that every step reads
=====================  ===============================================================
"""
