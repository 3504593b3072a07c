"""
A person's hand-made expressions to quasi-eigen faces, which cover what the person was captured doing.

INPUTS:   files  = neutral head, takes that tell what the face does, hand-made expressions
OUTPUTS:  faces  = results/{person}/quasi_eigen/faces.npz: hand-made, eigen and quasi-eigen faces
          basis  = results/{person}/quasi_eigen/basis.glb: the quasi-eigen faces as morph targets
          weights = results/{person}/quasi_eigen/weights.csv: the takes as weights of the quasi-eigen faces, frame by frame
          errors = results/{person}/quasi_eigen/errors.json: how well each basis reproduces the takes
          figures = results/{person}/quasi_eigen/figures.json
"""


rule quasi_eigen:
    """Quasi-eigen faces of one person, and how well they reproduce the takes."""
    input:
        files=expression_inputs,
    output:
        faces="results/{person}/quasi_eigen/faces.npz",
        basis="results/{person}/quasi_eigen/basis.glb",
        weights="results/{person}/quasi_eigen/weights.csv",
        errors="results/{person}/quasi_eigen/errors.json",
        figures="results/{person}/quasi_eigen/figures.json",
    log:
        "results/{person}/logs/quasi_eigen.log",
    benchmark:
        "results/{person}/benchmarks/quasi_eigen.tsv"
    resources:
        mem_mb=2000,
    params:
        person=expression_person,
        settings=training_setting("quasi_eigen"),
        limits=expression_limits,
        source=source("quasi_eigen"),
    script:
        "../pipeline/quasi_eigen.py"
