"""The whole model of the neck paper (eq. 4, 5): a head model with speech blendshapes, and each person's larynx."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from headcap.artifacts import load_arrays, save_arrays
from headcap.errors import InputError
from headcap.heads import HeadCoefficients, HeadModel
from headcap.neck.larynx.base_shape import Throat, initial_larynx
from headcap.neck.larynx.larynx_map import LarynxMap

KIND, SCHEMA = "neck_model", 1


@dataclass(frozen=True, eq=False)
class NeckPerson:
    """One person's base shape and larynx."""

    name: str
    base: NDArray[np.float64]
    """T_0, (n, 3) metres at rest: the neutral head without its larynx."""
    larynx: LarynxMap
    """W and t_s; tau = 0, alpha = 1 give the neutral head back (eq. 1)."""

    @property
    def neutral(self) -> NDArray[np.float64]:
        """T of eq. 1, (n, 3) metres: the base shape with the larynx at rest."""
        out = np.array(self.base, float)
        out[self.larynx.vertices] += self.larynx.offset(0.0, 1.0).values
        return out

    @classmethod
    def of(cls, name: str, neutral: NDArray, triangles: NDArray, empty: LarynxMap) -> NeckPerson:
        """From a neutral head (n, 3) alone, by eq. 8 to 10; `empty` is the topology's larynx map without weights."""
        throat, larynx = initial_larynx(Throat.of(neutral, triangles, empty), empty)
        base = np.array(neutral, float)
        base[empty.vertices] = throat
        return cls(name, base, larynx)


@dataclass(frozen=True, eq=False)
class NeckModel:
    """Shared blendshapes and the people whose larynx is known."""

    head: HeadModel
    """With the speech basis N."""
    people: tuple[NeckPerson, ...]

    @cached_property
    def version(self) -> str:
        """sha256 of what coefficients mean in this model: what a regressor must agree on. People are no part of it."""
        return hashlib.sha256(f"{KIND}/{SCHEMA}:{self.head.digest}".encode()).hexdigest()

    def person(self, name: str) -> NeckPerson:
        """The person of that name; raises `InputError` for an unknown one."""
        for person in self.people:
            if person.name == name:
                return person
        raise InputError(
            f"person {name}",
            expected=f"one of {', '.join(p.name for p in self.people) or 'none: the model holds nobody'}",
            remedy="Fit the person's neutral head first.",
        )

    def with_person(self, person: NeckPerson) -> NeckModel:
        """The model with one more person, in place of one of the same name."""
        person.larynx.check(self.head)
        return replace(self, people=(*(p for p in self.people if p.name != person.name), person))

    def of_person(self, person: NeckPerson) -> NeckModel:
        """The model with one person alone."""
        person.larynx.check(self.head)
        return replace(self, people=(person,))

    def evaluate(
        self, person: NeckPerson, coefficients: HeadCoefficients, tau_m: NDArray | float, alpha: NDArray | float
    ) -> NDArray[np.floating]:
        """Meshes (..., n, 3) of eq. 4 and 5 for any batch shape of coefficients, tau (metres) and alpha."""
        return self.head.personal(person.base).evaluate(coefficients, person.larynx.offset(tau_m, alpha))

    def save(self, path: Path | str) -> None:
        """Write as npz artifact `headcap.neck_model/1`."""
        arrays, head = self.head.to_arrays()
        arrays = {f"head/{name}": array for name, array in arrays.items()}
        people = []
        for k, person in enumerate(self.people):
            own, larynx = person.larynx.to_arrays()
            arrays |= {f"person/{k}/larynx/{name}": array for name, array in own.items()}
            arrays[f"person/{k}/base"] = person.base
            people.append({"name": person.name, "larynx": larynx})
        save_arrays(path, KIND, SCHEMA, arrays, {"head": head, "people": people})

    @classmethod
    def load(cls, path: Path | str) -> NeckModel:
        """Read what `save` wrote; raises `ArtifactError`."""
        arrays, meta = load_arrays(path, KIND, SCHEMA)
        head = HeadModel.from_arrays(_under("head/", arrays), meta["head"])
        people = tuple(
            NeckPerson(
                record["name"],
                arrays[f"person/{k}/base"],
                LarynxMap.from_arrays(_under(f"person/{k}/larynx/", arrays), record["larynx"]),
            )
            for k, record in enumerate(meta["people"])
        )
        return cls(head, people)


def _under(prefix: str, arrays: dict[str, NDArray]) -> dict[str, NDArray]:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
