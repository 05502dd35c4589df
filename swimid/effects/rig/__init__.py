"""Effects of the test rig: pulley, string and how the run was started."""
