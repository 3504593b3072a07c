"""From takes of several people to the model that they share (paper, section 5)."""
