"""The monocular base tracker (lip correction paper, section 3.2): analysis by synthesis of one camera's pictures on a head model."""
