import json
from pathlib import Path

import pytest

from headcap.settings import schemas

FOLDER = Path(__file__).parents[2] / "config" / "schema"


@pytest.mark.parametrize("name", ["session", "study"])
def test_schema_file_is_in_step_with_the_settings(name: str) -> None:
    assert json.loads((FOLDER / f"{name}.json").read_text()) == schemas()[name], "run: headcap schema --write"


def test_every_object_is_closed_and_every_session_key_described() -> None:
    schema = schemas()["session"]
    objects = [schema, *(part for part in schema["$defs"].values() if part["type"] == "object")]
    assert all(part["additionalProperties"] is False for part in objects)
    assert [key for key, value in schema["properties"].items() if "description" not in value and "$ref" not in value] == []
