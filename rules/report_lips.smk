"""
The page of a study's lips: tables 1 to 3 of the lip paper, and its figures 5 and 14 to 16 on takes that no regressor has learnt.

INPUTS:   tables, figures = results/{study}/evaluate_lips/tables.json, figures.json
          maps, comparisons, curves = results/{study}/correct_lips/{person}/maps.png, shapes.png, curves.png
          inpainted       = results/{session}/inpaint_lips/{take}.png of tattooed takes
          sheets          = results/{study}/track_monocular/{person}/{take}.png
OUTPUTS:  page            = results/{study}/report_lips/lips.html
"""


rule report_lips:
    """The study's page of lips."""
    input:
        tables="results/{study}/evaluate_lips/tables.json",
        figures="results/{study}/evaluate_lips/figures.json",
        maps=lip_person_files("maps.png"),
        comparisons=lip_person_files("shapes.png"),
        curves=lip_person_files("curves.png"),
        inpainted=all_inpainted,
        sheets=all_lip_sheets,
    output:
        page="results/{study}/report_lips/lips.html",
    log:
        "results/{study}/logs/report_lips.log",
    benchmark:
        "results/{study}/benchmarks/report_lips.tsv"
    resources:
        mem_mb=1500,
    params:
        people=lip_roles,
        settings=described_study,
        source=source("report_lips"),
    script:
        "../pipeline/report_lips.py"
