"""What is wrong with a subject's folder, all in one pass: ``gva-mi check``.

Steps open a folder strictly and stop at the first thing that they cannot use; and what has the
right shape they believe, though it may mean something else than they think. Here all that can be
read is looked at, one kind of evidence a file, and each fault has a finding of its own:

=================  =================================================================================
``contents``       what can be read of the folder, whatever else is wrong with it
``files``          counts, sizes, masks that say nothing, splits, the body
``cameras``        ``K`` and ``T_camera_world`` as matrices
``poses``          numbers of the poses: finite, in radians and metres, of a person
``seen``           what is compared: joints, silhouettes and masks in small pictures
``readings``       other things that the same numbers may mean: axes, units, mirrored, late
``silhouettes``    joints and silhouettes against masks, under each reading
``normals``        the sign of each axis of the normals, against the body's own
``check``          all of it
``glance``         one look, before hours of work in other steps
``sheet``          frames with mask and silhouette, for people
=================  =================================================================================

No limit is a property of this program's synthetic people: each is argued where it stands.
"""

from gva_mi.data.check.check import check_subject
from gva_mi.data.check.findings import Finding, Report

__all__ = ["Finding", "Report", "check_subject"]
