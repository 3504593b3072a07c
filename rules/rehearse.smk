"""
Renders the recordings of a rehearsed session, with truth in a folder of its own.

INPUTS:   none; the session's `rehearse` settings
OUTPUTS:  rehearsal = results/{session}/rehearse/rehearsal.json, and beside it what it lists:
                      board.yaml, calibration/, takes/, scan/, truth/
"""


rule rehearse:
    """Recordings of a board and of each take, a scan, and their truth."""
    output:
        rehearsal="results/{session}/rehearse/rehearsal.json",
    log:
        "results/{session}/logs/rehearse.log",
    benchmark:
        "results/{session}/benchmarks/rehearse.tsv"
    # the one stage that is no job per camera or chunk: it renders its pieces side by side itself
    threads: workflow.cores
    resources:
        mem_mb=2500,
    params:
        settings=setting("rehearse"),
        source=source("rehearse"),
    script:
        "../pipeline/rehearse.py"
