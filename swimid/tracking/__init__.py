"""Video to pose: from coloured markers in a film to a log with its uncertainty.

``reader`` yields frames with their time stamps. ``detect`` measures one marker by its colour in a small
window. ``tracker`` follows all markers through the film, and ``silhouette`` a whole body. ``pose`` converts
pixels to metres and computes the columns of the log with the Kalman smoother of ``smooth``, which estimates
its noise from the data. ``quality`` has the checks. The command ``track_video`` writes log, evidence and a
film with the track drawn in. The command ``track_setup`` drafts a ``setup`` with the markers that ``propose``
finds. ``options`` are those of both.

Frames of reference: columns of markers, ``<name>_x_px`` and ``<name>_y_px``, are
coordinates of the picture: the origin is the centre of the upper left pixel, x points to the right and y
**down**. Poses are right-handed. Without a homography the picture is flipped: y (z in the vertical plane)
points up from the lowest row of pixels, and yaw is counter-clockwise in the picture. With a homography the
axes are those of the calibration points.
"""
