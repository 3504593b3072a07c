"""
A person's tested takes with their lips corrected, and how far each way to correct them is from the true meshes.

INPUTS:   base, regressors = results/{study}/head_model/base.npz, train_lips/{regressor}.npz that may be tested on the person
          files            = base tracks, contours, true meshes and pictures of the person's filmed takes
OUTPUTS:  errors     = results/{study}/correct_lips/{person}/{take}.errors.npz
          sequences  = results/{study}/correct_lips/{person}/{take}.json, mesh sequences in the rig's world
          maps, comparison, curves, video = results/{study}/correct_lips/{person}/maps.png, shapes.png, curves.png, first.mp4
"""

for name in PLAN.lip_tested:

    rule:
        name:
            f"correct_lips_{name}"
        input:
            base=f"results/{PLAN.name}/head_model/base.npz",
            regressors=lip_regressors(plan.name for plan in tested_plans(name)),
            files=lip_person_inputs(name),
        output:
            errors=lip_tested_files(name, ".errors.npz"),
            sequences=lip_tested_files(name, ".json"),
            maps=f"results/{PLAN.name}/correct_lips/{name}/maps.png",
            comparison=f"results/{PLAN.name}/correct_lips/{name}/shapes.png",
            curves=f"results/{PLAN.name}/correct_lips/{name}/curves.png",
            video=f"results/{PLAN.name}/correct_lips/{name}/first.mp4",
        log:
            f"results/{PLAN.name}/logs/correct_lips/{name}.log",
        benchmark:
            f"results/{PLAN.name}/benchmarks/correct_lips/{name}.tsv"
        resources:
            mem_mb=4000,
        params:
            person=lip_person(name),
            plans=described_plans(tested_plans(name)),
            tested=list(PLAN.lip_tests(name)),
            learnt_from=lip_learnt_from(name),
            settings=PLAN.study.train_lips.model_dump(mode="json"),
            source=source("correct_lips"),
        script:
            "../pipeline/correct_lips.py"
