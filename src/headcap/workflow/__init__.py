"""What the Snakefile, the stage scripts and `headcap run` share: code digests, the run lock, progress, gates."""
