"""Board detection, intrinsics, rig bundle adjustment, held-out error, the rig's frame, timing and bumped cameras."""
