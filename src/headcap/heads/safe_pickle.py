"""Reading model pickles of others without running them: a whitelist of what may be named, everything else is refused.

FLAME's files are Python 2 pickles of numpy arrays, scipy matrices and chumpy objects. None of these libraries unpickles anything
here: what they would build is read as inert records, and plain numbers are taken out of those.
"""

from __future__ import annotations

import pickle
import re
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


class _Type(_Record):
    """A numpy dtype."""

    def numeric(self) -> np.dtype | None:
        """The dtype, None where it is not of plain numbers."""
        code = self.args[0] if self.args else None
        order = self.state[1] if isinstance(self.state, tuple) and len(self.state) > 1 else "|"
        if not isinstance(code, str) or not re.fullmatch(r"[biuf]\d{1,2}", code) or order not in ("<", ">", "=", "|"):
            return None
        return np.dtype(order + code)


class _Array(_Record):
    """A numpy array; its state is (version, shape, type, whether columns come first, content)."""

    def array(self) -> NDArray:
        """Its value; None where it does not hold plain numbers."""
        if not isinstance(self.state, tuple) or len(self.state) < 4:
            return np.array(None)
        shape, kind, fortran, content = self.state[-4:]
        dtype = kind.numeric() if isinstance(kind, _Type) else None
        if dtype is None or not isinstance(content, str | bytes | bytearray):
            return np.array(None)
        raw = content.encode("latin1") if isinstance(content, str) else bytes(content)
        # a copy: what bytes hold cannot be written
        return np.frombuffer(raw, dtype).reshape(shape, order="F" if fortran else "C").copy()


def _new_array(*_: Any) -> _Array:
    """`numpy.core.multiarray._reconstruct`: the content comes as state."""
    return _Array()


def _scalar(kind: Any, content: Any = b"") -> _Array:
    """`numpy.core.multiarray.scalar`."""
    return _filled((), kind, False, content)


def _from_buffer(content: Any, kind: Any, shape: Any, order: Any) -> _Array:
    """`numpy.core.numeric._frombuffer`, of pickle's fifth protocol."""
    return _filled(shape, kind, order == "F", content)


def _filled(*state: Any) -> _Array:
    array = _Array()
    array.__setstate__(state)
    return array


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


def _no_bytes() -> bytes:
    """`bytes()`, which is how old protocols write empty ones."""
    return b""


_MULTIARRAY = {"_reconstruct": _new_array, "scalar": _scalar}
_NUMERIC = {"_frombuffer": _from_buffer}
_PLAIN = {"object": object, "set": set, "frozenset": frozenset, "bytes": _no_bytes}
"""Chumpy's nodes keep sets of their own."""
_ALLOWED: dict[str, dict[str, Any]] = {
    "numpy": {"ndarray": _Array, "dtype": _Type},
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

    Only numpy arrays, scipy matrices and chumpy nodes are understood, and none is built by its library. Raises `InputError`
    where the file asks for anything else, is cut short, or holds no dictionary.
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
    except Exception as error:  # a damaged stream can break off anywhere
        raise InputError(
            f"{path.name} cannot be read as a pickled model ({error})",
            expected="a whole pickle of named arrays",
            remedy="Download the file again.",
        ) from error


def _array(value: Any) -> NDArray:
    if isinstance(value, _Array | _Chumpy | _Sparse):
        return value.array()
    plain = isinstance(value, int | float) or (isinstance(value, list | tuple) and all(isinstance(v, int | float) for v in value))
    return np.asarray(value if plain else None)
