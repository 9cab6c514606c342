"""One component on a test rig: wheel and rail, a yaw damper."""
