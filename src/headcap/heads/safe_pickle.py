"""Reading model pickles of others without running them: a whitelist of what may be built, everything else is refused.

FLAME's files are Python 2 pickles of numpy arrays, scipy matrices and chumpy objects. Chumpy is not needed: its objects are read
as inert records and their arrays taken out.
"""

from __future__ import annotations

import pickle
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from headcap.errors import InputError


class _Refused(pickle.UnpicklingError):
    """A global that is not on the whitelist."""


class _Record:
    """Stands for an object of a library we do not run: keeps what it would be made of."""

    def __new__(cls, *args: Any, **_: Any) -> _Record:
        """Take any arguments, as the class stood for may."""
        record = object.__new__(cls)
        record.args, record.state = args, {}
        return record

    def __setstate__(self, state: Any) -> None:
        self.state = state


class _Chumpy(_Record):
    """A chumpy node: `Ch` holds its array in x; `Select` picks `idxs` of another node."""

    def array(self) -> NDArray:
        """Its value; None where it is an expression that only chumpy could work out."""
        state = self.state if isinstance(self.state, dict) else {}
        if "x" in state:
            return _array(state["x"])
        if "a" in state and "idxs" in state:
            picked = _array(state["a"]).ravel()[_array(state["idxs"]).astype(np.int64)]
            return picked.reshape(state["preferred_shape"]) if "preferred_shape" in state else picked
        return np.array(None)


class _Sparse(_Record):
    """A scipy matrix of any version."""

    layout = "csr"

    def array(self) -> NDArray:
        """Its dense value."""
        parts = self.state
        shape = parts.get("_shape", parts.get("shape"))
        if self.layout == "coo":
            where = (_array(parts["row"]), _array(parts["col"])) if "row" in parts else tuple(map(_array, parts["coords"]))
            return sparse.coo_array((_array(parts["data"]), where), shape=shape).toarray()
        build = {"csr": sparse.csr_array, "csc": sparse.csc_array}[self.layout]
        return build((_array(parts["data"]), _array(parts["indices"]), _array(parts["indptr"])), shape=shape).toarray()


_LAYOUTS = {f"{layout}_{kind}": type(f"_{layout}", (_Sparse,), {"layout": layout})
            for layout in ("csr", "csc", "coo") for kind in ("matrix", "array")}  # fmt: skip


def _new_record(cls: type, base: type, state: Any) -> Any:
    """`copyreg._reconstructor`, for records only."""
    if base is not object or state is not None or not (isinstance(cls, type) and issubclass(cls, _Record)):
        raise _Refused(f"an object built from {cls!r}")
    return cls()


def _latin1(text: str, encoding: str) -> bytes:
    """`codecs.encode` as pickles of bytes use it."""
    if encoding != "latin1":
        raise _Refused(f"bytes encoded as {encoding!r}")
    return text.encode("latin1")


_MULTIARRAY = {"_reconstruct": np._core.multiarray._reconstruct, "scalar": np._core.multiarray.scalar}
_NUMERIC = {"_frombuffer": np._core.numeric._frombuffer}
_PLAIN = {"object": object, "set": set, "frozenset": frozenset}
"""Chumpy's nodes keep sets of their own."""
_ALLOWED: dict[str, dict[str, Any]] = {
    "numpy": {"ndarray": np.ndarray, "dtype": np.dtype},
    "numpy.core.multiarray": _MULTIARRAY,
    "numpy._core.multiarray": _MULTIARRAY,
    "numpy.core.numeric": _NUMERIC,
    "numpy._core.numeric": _NUMERIC,
    "copy_reg": {"_reconstructor": _new_record},
    "copyreg": {"_reconstructor": _new_record},
    "__builtin__": _PLAIN,
    "builtins": _PLAIN,
    "collections": {"OrderedDict": OrderedDict},
    "_codecs": {"encode": _latin1},
}


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        """The only door to anything that could run."""
        if name in _ALLOWED.get(module, {}):
            return _ALLOWED[module][name]
        if module.split(".")[0] == "chumpy" and name.isidentifier():
            return _Chumpy
        if module.startswith("scipy.sparse") and name in _LAYOUTS:
            return _LAYOUTS[name]
        raise _Refused(f"{module}.{name}")

    def persistent_load(self, pid: Any) -> Any:
        """No file of a model refers to objects outside itself."""
        raise _Refused(f"the outside object {pid!r}")


def load_pickled_arrays(path: Path | str) -> dict[str, NDArray]:
    """The numeric arrays of a pickled dictionary, by key; text, notes and whatever else is no number are left out.

    Only numpy arrays, scipy matrices and chumpy records are built. Raises `InputError` where the file asks for anything else, is
    cut short, or holds no dictionary.
    """
    path = Path(path)
    try:
        with open(path, "rb") as handle:
            content = _Unpickler(handle, encoding="latin1").load()
        if not isinstance(content, dict):
            raise _Refused(f"a {type(content).__name__} where a dictionary should be")
        arrays = {str(key): _array(value) for key, value in content.items()}
        return {key: array for key, array in arrays.items() if array.dtype.kind in "biuf"}
    except _Refused as error:
        raise InputError(
            f"{path.name} asks for {error}, which no model file needs; nothing of it was run",
            expected="numpy arrays, scipy matrices and chumpy arrays",
            remedy="Do not use this file; download the model again from its authors' site.",
        ) from error
    except (pickle.UnpicklingError, EOFError, AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path.name} cannot be read as a pickled model ({error})",
            expected="a whole pickle of named arrays",
            remedy="Download the file again.",
        ) from error


def _array(value: Any) -> NDArray:
    return value.array() if isinstance(value, _Chumpy | _Sparse) else np.asarray(value)
