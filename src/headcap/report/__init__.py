"""Figures, overlays and the HTML report of a session: one file that opens from disk, without any network."""
