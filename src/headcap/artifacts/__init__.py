"""Versioned files: kind, schema version, atomic save, strict load, provenance. See FORMATS.md beside this file."""

from headcap.artifacts.files import ArtifactError, Name, atomic_path, load_arrays, load_json, save_arrays, save_json
from headcap.artifacts.manifest import Manifest, digest_file, digest_settings, manifest_path, write_manifest

__all__ = [
    "ArtifactError",
    "Manifest",
    "Name",
    "atomic_path",
    "digest_file",
    "digest_settings",
    "load_arrays",
    "load_json",
    "manifest_path",
    "save_arrays",
    "save_json",
    "write_manifest",
]
