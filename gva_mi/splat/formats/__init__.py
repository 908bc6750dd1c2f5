"""Files of Gaussians for other programs.

Writers take, and ``load_ply`` returns, Gaussians in the axes of the .ply of 3DGS: x right, y down,
z forward. :func:`gva_mi.splat.axes.half_turned` turns them to this program's world and back.

==================  =======================================================
``ply``             the .ply of 3D Gaussian Splatting and its viewers
``spz``             Niantic's, about 20 bytes a Gaussian before compression, and
                    the .splat, 32 bytes a Gaussian, for viewers in a browser
``gltf``            the .glb of KHR_gaussian_splatting, read and written; its Gaussians
                    are in the axes of this program's world
``stored``          numbers to store, for all formats
==================  =======================================================
"""
