"""The lips: a monocular base tracker, lip contours, and a correction learnt from the rig (Garrido et al. 2016)."""
