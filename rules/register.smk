"""
Brings the scan into the model's topology.

INPUTS:   scan = the session's scan; picks = points picked on it, where the session names some
OUTPUTS:  template  = results/{session}/register/template.npz, with the scan's texture
          placement = results/{session}/register/placement.json, where the scan lay
"""


rule register:
    """The subject's neutral face in the model's topology."""
    input:
        scan=scan,
        picks=picks,
    output:
        template="results/{session}/register/template.npz",
        placement="results/{session}/register/placement.json",
    log:
        "results/{session}/logs/register.log",
    benchmark:
        "results/{session}/benchmarks/register.tsv"
    resources:
        mem_mb=3000,
    params:
        described=scan_paths,
        limits=limits("register"),
        allow=setting("allow"),
        settings=setting("register"),
        source=source("register"),
    script:
        "../pipeline/register.py"
