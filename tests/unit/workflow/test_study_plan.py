"""Who trains and who is held out: a study's people, takes and voices, and everything about them that cannot be."""

import copy

import pytest

from headcap.errors import InputErrors
from headcap.workflow.plan import load_plan, rehearsed_meshes

TAKES = [{"name": "nod", "kind": "pose"}, {"name": "talk", "kind": "speech"}]
STUDY = {
    "study": "necks",
    "mesh_subjects": [{"subject": name, "rehearse_meshes": {"seed": k, "takes": TAKES}} for k, name in enumerate("abc")],
    "held_out": ["c"],
    "groups": [{"name": "both", "people": ["a", "b"]}],
}


def changed(**changes) -> dict:
    return copy.deepcopy(STUDY) | changes


def told(document: dict) -> str:
    with pytest.raises(InputErrors) as caught:
        load_plan(document)
    return str(caught.value)


def test_a_study_knows_who_trains_and_whose_voices():
    plan = load_plan(changed())
    assert plan.people == ("a", "b", "c")
    assert plan.training == ("a", "b")
    assert plan.neck_people == ("a", "b", "c")
    assert plan.takes("c", "pose") == {"nod": "pose"}
    assert plan.heard("a") == ("talk",)
    assert {name: voice.people for name, voice in plan.voices.items()} == {"a": ("a",), "b": ("b",), "both": ("a", "b")}
    assert not plan.is_session


def test_a_session_by_itself_is_a_study_of_its_own_name():
    plan = load_plan({"session": "solo", "rehearse": {"takes": TAKES}, "train_neck": {"speech": {"iterations": 3}}})
    assert plan.is_session
    assert (plan.name, plan.training, list(plan.voices)) == ("solo", ("solo",), ["solo"])
    assert plan.study.train_neck.speech.iterations == 3
    silent = load_plan({"session": "solo", "rehearse": {"takes": TAKES}, "train_speech": None})
    assert (silent.neck_people, silent.voices) == (("solo",), {})


def test_without_speech_that_trains_there_is_no_neck():
    assert load_plan({"session": "solo", "rehearse": {"takes": TAKES[:1]}}).neck_people == ()


def test_what_a_rehearsed_subject_says_itself_stands():
    document = changed()
    entry = document["mesh_subjects"][0]
    filled = rehearsed_meshes(load_plan(document).meshes["a"].rehearse_meshes, "a")
    entry["takes"] = [filled["takes"][1] | {"sound": None}]
    assert load_plan(document | {"groups": []}).heard("a") == ()


@pytest.mark.parametrize(
    ("document", "message"),
    [
        (changed(held_out=["d"]), "held_out: nobody is called d"),
        (changed(held_out=["a", "b", "c"], groups=[]), "everybody is held out"),
        (changed(study="a"), "study: a is also a person's name"),
        (changed(groups=[{"name": "all", "people": ["c"]}]), "groups.all: everybody in it is held out"),
        (changed(groups=[{"name": "all", "people": ["a", "z"]}]), "groups.all: nobody is called z"),
        (changed(groups=[{"name": "a", "people": ["a"]}]), "groups.a: a person has that name"),
        (changed(groups=[{"name": "x", "people": ["a"]}] * 2), "groups: x is named twice"),
        (changed(groups=[{"name": "x", "people": ["a"], "coefficients": "tau"}]), "groups.0.coefficients"),
        (changed(mesh_subjects=STUDY["mesh_subjects"] + STUDY["mesh_subjects"][:1]), "two sessions or subjects are called a"),
        (changed(mesh_subjects=[], held_out=[], groups=[]), "nobody to work on"),
    ],
)
def test_people_who_cannot_be_are_named(document, message):
    assert message in told(document)


def test_wrong_subjects_are_told_by_key():
    document = changed()
    document["mesh_subjects"][1]["rehearse_meshes"] = {"sead": 3, "takes": TAKES}
    assert "mesh_subjects.1.rehearse_meshes.sead: unknown key" in told(document)
    document = changed()
    document["mesh_subjects"][0]["limits"] = {"neck.pose": 1.0}
    assert "a, limits: no figure is called neck.pose" in told(document)
    document = changed()
    document["mesh_subjects"][0]["rehearse_meshes"]["takes"] = TAKES + TAKES[:1]
    assert "names must differ" in told(document)


def test_files_that_are_not_there_are_named(tmp_path):
    takes = [{"name": "talk", "kind": "speech", "sequence": str(tmp_path / "talk.json"), "sound": str(tmp_path / "talk.wav")}]
    entry = {"subject": "own", "template": str(tmp_path / "template.npz"), "takes": takes}
    (tmp_path / "talk.json").touch()
    message = told(changed(mesh_subjects=[*STUDY["mesh_subjects"], entry]))
    assert f"own.template: {tmp_path / 'template.npz'} is not there" in message
    assert "talk.wav is not there" in message
    assert "talk.json" not in message


LIPS = [{"name": "kiss", "kind": "lips", "lip_tattoo": False}, {"name": "talk", "kind": "speech"}]


def filmed(**changes) -> dict:
    people = [
        {"subject": name, "rehearse_meshes": {"seed": k, "video": {}, "takes": LIPS}} for k, name in enumerate(("d", "e", "f"))
    ]
    return {"study": "lips", "mesh_subjects": people, "held_out": ["f"], "train_lips": {"test_takes": ["kiss"]}} | changes


def test_lips_are_learnt_where_somebody_who_trains_performs_them_before_a_camera():
    plan = load_plan(filmed())
    assert plan.lip_people == ("d", "e", "f")
    assert (plan.lip_tests("d"), plan.lip_tests("f")) == (("kiss",), ("kiss", "talk"))
    named = {regressor.name: regressor for regressor in plan.lip_regressors}
    assert set(named) == {"generic", "generic_affine", "generic_shape", "generic_distances", "several", "of_d", "of_e"}
    assert named["generic"].tests("f")
    assert not named["generic"].tests("d")
    assert named["several"].tests("d")
    assert not named["of_d"].tests("e")
    assert named["generic_affine"].method == "GR affine"
    assert load_plan(changed()).lip_people == ()
    assert load_plan(filmed(held_out=["d", "e"], train_lips={})).lip_tested == ("d", "e")


def test_videos_without_a_camera_are_told():
    document = filmed()
    document["mesh_subjects"][0]["camera"] = None
    assert "takes have videos, but camera names none" in told(document)


def test_a_lip_camera_that_the_session_has_not_is_told():
    assert "lip_camera: no camera is called left" in told({"session": "solo", "rehearse": {"takes": TAKES}, "lip_camera": "left"})


def tattooed(*takes: dict, **changes) -> dict:
    return {"session": "solo", "rehearse": {"takes": list(takes)}} | changes


def test_tattooed_lips_are_painted_over_with_those_of_another_take():
    kiss, nod, talk = {"name": "kiss", "kind": "lips"}, *TAKES
    plan = load_plan(tattooed(kiss, nod, talk))
    assert plan.inpainted == (("solo", "kiss"),)
    # a mouth that speaks opens
    assert plan.sessions["solo"].bare_take == "talk"
    assert load_plan(tattooed(kiss, nod, talk, untattooed_take="nod")).sessions["solo"].bare_take == "nod"
    assert load_plan(tattooed(kiss | {"lip_tattoo": False}, talk | {"lip_tattoo": True})).inpainted == (("solo", "talk"),)
    files = {"files": "{camera}.mp4"}
    said = load_plan(tattooed(kiss, talk, takes=[kiss | files, talk | files | {"lip_tattoo": True}, nod | files]))
    assert said.inpainted == (("solo", "kiss"), ("solo", "talk"))
    # nobody who trains performs lips
    assert load_plan(tattooed(talk | {"lip_tattoo": True})).inpainted == ()


def test_tattooed_lips_that_no_take_shows_bare_are_told_before_any_job():
    kiss, talk = {"name": "kiss", "kind": "lips"}, TAKES[1] | {"lip_tattoo": True}
    message = "solo: the lips are tattooed in kiss, talk, and no take shows them without"
    assert message in told(tattooed(kiss, talk))
    assert message in told(changed(sessions=[tattooed(kiss, talk)]))
    assert "untattooed_take: no take is called nod" in told(tattooed(kiss, talk, untattooed_take="nod"))
    assert "untattooed_take: the lips are tattooed in kiss" in told(tattooed(kiss, TAKES[1], untattooed_take="kiss"))


def test_labels_by_hand_are_of_filmed_takes_of_people_who_train(tmp_path):
    (tmp_path / "kiss.json").touch()
    drawn = {"d": {"kiss": str(tmp_path / "kiss.json")}}
    assert load_plan(filmed(train_lips={"labels": drawn})).study.train_lips.labels == drawn
    wrong = {
        "d": {"hug": str(tmp_path / "kiss.json"), "talk": "talk.json"},
        "f": {"kiss": str(tmp_path)},
        "x": {"kiss": str(tmp_path)},
    }
    message = told(filmed(train_lips={"labels": wrong}))
    for line in (
        "train_lips.labels: hug is no filmed take of a d who trains",
        "train_lips.labels: kiss is no filmed take of a f who trains",
        "train_lips.labels: kiss is no filmed take of a x who trains",
        "train_lips.labels.d.talk: talk.json is not there",
    ):
        assert line in message
