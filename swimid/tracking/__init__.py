"""Tracking of coloured markers in a film, to make a log of poses with their standard deviations.

``frames`` yields frames with their time stamps, and measures one marker by its colour in a small window.
``tracker`` follows all markers through the film, and ``silhouette`` follows a whole body. ``pose`` converts
pixels to metres, smooths them and computes the columns of the log. The command ``track_video`` writes the
log, a file with checks and results, and a film with the track drawn in. The command ``track_setup`` drafts a
``setup``, with markers that ``proposals`` finds in the film or about pixels that the user picks. ``picking``
is the page in the browser on which markers are picked, and ``pick_server`` its server. The command
``track_camera`` calibrates a camera from pictures of a checkerboard. ``options`` contains the options of all
commands.

Frames of reference
-------------------
The columns ``<name>_x_px`` and ``<name>_y_px`` of a marker are coordinates of the picture: the origin is the
centre of the upper left pixel, x points to the right and y **down**. Poses are right-handed. Without a
homography the picture is flipped: y (z in the vertical plane) points up from the lowest row of pixels, and
yaw is counter-clockwise in the picture. With a homography the axes are those of the calibration points.
"""
