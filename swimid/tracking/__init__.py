"""Video to pose: from coloured markers in a film to a log with its uncertainty.

``reader`` gives frames and their own time stamps. ``detect`` measures one marker in a small window by its
colour, and ``tracker`` keeps every marker from the first frame to the last (``silhouette``: a whole body).
``pose`` turns pixels into metres and puts the log together; its Kalman smoother, ``smooth``, has process
noise estimated from the data. ``quality`` judges. The verb ``track_video`` writes log, evidence and frames
with the track drawn in; the verb ``track_setup`` drafts a ``setup`` from what ``propose`` finds. ``options``
are those of both.

Frames of reference
-------------------
Marker columns ``<name>_x_px``, ``<name>_y_px`` are image coordinates: origin in the centre
of the upper left pixel, x to the right, y **down**. Poses are right-handed: without a
homography the picture is flipped, so that y (z in the vertical plane) points up from the
lowest pixel row and yaw is counter-clockwise as seen in the picture. With a homography the
world axes are those of ``points_m``.
"""
