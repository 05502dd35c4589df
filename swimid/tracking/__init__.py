"""Video to pose: from coloured markers in a film to a log with its uncertainty.

``reader`` gives frames and their own time stamps. ``detect`` measures one marker in a small window by its
``colour``, and ``tracker`` keeps every marker from the first frame to the last (``silhouette``: a whole
body). ``plane`` turns pixels into metres, ``smooth`` filters with process noise estimated from the data,
and ``pose`` puts them together; ``quality`` judges. The verb ``track_video`` writes log and ``evidence``,
with frames drawn by ``pictures``. The verb ``track_setup`` drafts a ``setup`` (``propose``, ``pick``).
``options`` are those of both.

Frames of reference
-------------------
Marker columns ``<name>_x_px``, ``<name>_y_px`` are image coordinates: origin in the centre
of the upper left pixel, x to the right, y **down**. Poses are right-handed: without a
homography the picture is flipped, so that y (z in the vertical plane) points up from the
lowest pixel row and yaw is counter-clockwise as seen in the picture. With a homography the
world axes are those of ``points_m``.
"""
