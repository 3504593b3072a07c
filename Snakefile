"""
headcap: from the recordings of a camera rig to a tracked head, a model of its neck, and lips corrected in a single video.

    snakemake                                            the demo study
    snakemake --configfile config/sessions/NAME.yaml     one capture session

Each file in rules/ is one stage and opens with its inputs and outputs; the science is in src/headcap.
"""

from snakemake.utils import min_version

min_version("9.27")


if not config:

    configfile: "config/demo.yaml"


container: "docker://headcap"


include: "rules/common.smk"


PLAN = read_plan(config)
repair_locks()


wildcard_constraints:
    study=PLAN.name,
    session=one_of(PLAN.sessions),
    person=one_of(PLAN.people),
    mesh_person=one_of(PLAN.meshes),
    voice=one_of(PLAN.voices),
    take="[A-Za-z0-9_-]+",
    recording="[A-Za-z0-9_-]+",
    camera="[A-Za-z0-9_-]+",
    chunk="[0-9]+",


localrules:
    all,


rule all:
    default_target: True
    input:
        metrics=expand("results/{session}/metrics.json", session=PLAN.sessions),
        report=expand("results/{session}/report/report.html", session=PLAN.sessions),
        study=study_results(),
        # named here so that they do not wait for the takes whose length is found out
        template=expand(
            "results/{session}/register/template.npz", session=PLAN.sessions
        ),
        timelines=all_timelines(),


include: "rules/rehearse.smk"
include: "rules/rehearse_meshes.smk"
include: "rules/ingest.smk"
include: "rules/sync.smk"
include: "rules/calibrate.smk"
include: "rules/register.smk"
include: "rules/reconstruct.smk"
include: "rules/track.smk"
include: "rules/head_model.smk"
include: "rules/train_expressions.smk"
include: "rules/train_neck.smk"
include: "rules/fit_neck.smk"
include: "rules/hear.smk"
include: "rules/train_speech.smk"
include: "rules/evaluate_neck.smk"
include: "rules/report_neck.smk"
include: "rules/inpaint_lips.smk"
include: "rules/track_monocular.smk"
include: "rules/train_contours.smk"
include: "rules/find_contours.smk"
include: "rules/train_lips.smk"
include: "rules/correct_lips.smk"
include: "rules/evaluate_lips.smk"
include: "rules/report_lips.smk"
include: "rules/quasi_eigen.smk"
include: "rules/report_expressions.smk"
include: "rules/evaluate.smk"


if not PLAN.is_session:

    include: "rules/evaluate_study.smk"


include: "rules/report.smk"
