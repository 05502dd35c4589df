"""Video to pose: from coloured markers in a film to a log with honest uncertainty.

``reader`` gives frames and their own time stamps; ``detect`` measures one marker in a small window by its
``colour``; ``search`` looks for it in a window or in the whole picture; ``target`` is what is known of a
marker; ``follow`` keeps every marker from frame to frame (``rawtrack``), ``run`` does so from the first to
the last; ``plane`` turns pixels into metres; ``smooth`` filters with process noise estimated from the data;
``pose`` puts them together; ``checks``, ``camera`` and ``motion`` judge. ``track_video`` is one verb
(``swim``: what a run comes to; ``pictures``), ``track_setup`` the other: it drafts a ``setup`` (``propose``,
``pick``). ``options`` are those of both.

Frames of reference
-------------------
Marker columns ``<name>_x_px``, ``<name>_y_px`` are image coordinates: origin in the centre
of the upper left pixel, x to the right, y **down**. Poses are right-handed: without a
homography the picture is flipped, so that y (z in the vertical plane) points up from the
lowest pixel row and yaw is counter-clockwise as seen in the picture. With a homography the
world axes are those of ``points_m``.
"""
