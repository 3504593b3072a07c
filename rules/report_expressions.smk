"""
The page of a person's quasi-eigen faces: figures 2 to 4 of the paper, its table of errors, and what each shape became.

INPUTS:   files   = neutral head, takes that tell what the face does, hand-made expressions
          faces   = results/{person}/quasi_eigen/faces.npz
          weights = results/{person}/quasi_eigen/weights.csv
          figures = results/{person}/quasi_eigen/figures.json
OUTPUTS:  page    = results/{person}/report_expressions/expressions.html
"""


rule report_expressions:
    """The page of one person's expressions."""
    input:
        files=expression_inputs,
        faces="results/{person}/quasi_eigen/faces.npz",
        weights="results/{person}/quasi_eigen/weights.csv",
        figures="results/{person}/quasi_eigen/figures.json",
    output:
        page="results/{person}/report_expressions/expressions.html",
    log:
        "results/{person}/logs/report_expressions.log",
    benchmark:
        "results/{person}/benchmarks/report_expressions.tsv"
    resources:
        mem_mb=2000,
    params:
        person=expression_person,
        settings=training_setting("quasi_eigen"),
        source=source("report_expressions"),
    script:
        "../pipeline/report_expressions.py"
