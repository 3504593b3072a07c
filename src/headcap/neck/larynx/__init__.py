"""The larynx: its chart on the throat, the map that slides over it, and how both are found (paper, sections 3.1 and 5.2)."""
