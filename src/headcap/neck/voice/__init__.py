"""From a voice to the neck's coefficients (paper, sections 6.2 and 7.3)."""
