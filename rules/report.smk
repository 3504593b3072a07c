"""
One page per session: figures, gates, pictures of every stage.

INPUTS:   results of all stages and takes, metrics = results/{session}/metrics.json
          neck_pictures = what the neck model and the voice's regressor say of the person
          sync_figures, residuals = what sync drew and what the tracker was left with, per take
OUTPUTS:  report  = results/{session}/report/report.html
          summary = results/{session}/report/summary.png, one line of pictures per take
"""


rule report:
    """The session's report."""
    input:
        unpack(session_results),
        sync_figures=sync_figures,
        residuals=take_residuals,
        neck_pictures=neck_pictures,
        placement="results/{session}/register/placement.json",
        metrics="results/{session}/metrics.json",
    output:
        report="results/{session}/report/report.html",
        summary="results/{session}/report/summary.png",
    log:
        "results/{session}/logs/report.log",
    benchmark:
        "results/{session}/benchmarks/report.tsv"
    resources:
        mem_mb=2500,
    params:
        takes=takes,
        scan=scan_paths,
        board=board,
        truth=truth,
        settings=described_session,
        source=source("report"),
    script:
        "../pipeline/report.py"
