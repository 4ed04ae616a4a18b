"""The netCDF file of a result: checksums of its content and of its bytes, and its reading."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Hashable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import xarray as xr
from xarray.conventions import cf_encoder, encode_dataset_coordinates

from coop_pin.base.errors import FileReadError, ScenarioError
from coop_pin.base.user_files import read_user_file
from coop_pin.description.scenario import Scenario
from coop_pin.results.dataset import with_names
from coop_pin.results.quantities import quantities

_MAX_BYTES = 2**32
"""Size limit of a result; one hour of two arms at 80 Hz has 0.4 GB."""
_SLACK_BYTES = 2**20
_NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable."
"""Name of the scale of a dimension without a variable, before its size."""
FILE = "result.nc"
"""Name of the file in the folder of a run."""
_SEAL = b"coop_pin sha256 "
_SEAL_BYTES = len(_SEAL) + hashlib.sha256().digest_size


def to_netcdf(data: xr.Dataset, scenario: str) -> memoryview:
    """Return the netCDF file of a dataset and the text of its scenario.

    The checksum of the content survives a copy by another program. That of the bytes stands behind the end of
    the netCDF, where its readers do not look: a damaged file is refused before HDF5 reads it.
    """
    data = data.assign_attrs(coop_pin_scenario=scenario)
    data.attrs["coop_pin_sha256"] = content_digest(data)
    buffer = written_netcdf(data)
    seal = _seal(buffer.getbuffer())
    buffer.seek(0, io.SEEK_END)
    buffer.write(seal)
    return buffer.getbuffer()  # long runs have hundreds of MB: without a copy


def written_netcdf(data: xr.Dataset) -> io.BytesIO:
    """Return a dataset as netCDF 4, with the variables and attributes of Dataset.to_netcdf.

    A dimension is a dimension scale of HDF5 with its number; h5netcdf takes eight times as long for it.
    """
    variables, attributes = cf_encoder(*encode_dataset_coordinates(data))
    buffer = io.BytesIO()  # in memory first: HDF5 that meets a full disk takes the process down
    with h5py.File(buffer, "w", track_order=True) as file:
        file.attrs.update(attributes)
        for name, variable in variables.items():
            values = np.asarray(variable.values)
            if values.dtype.kind in "OU":
                values = values.astype(object)
            kind = h5py.string_dtype() if values.dtype == object else values.dtype
            options = {"fillvalue": variable.attrs.get("_FillValue"), "track_order": True}
            file.create_dataset(name, data=values, dtype=kind, **options).attrs.update(variable.attrs)
        for number, (name, size) in enumerate(data.sizes.items()):
            scale = file[name] if name in file else file.create_dataset(name, (size,), ">f4")
            scale.make_scale(name if name in variables else f"{_NO_VARIABLE}{size:10}")
            scale.attrs["_Netcdf4Dimid"] = np.int32(number)
        for name, variable in variables.items():
            for axis, dimension in enumerate(() if variable.dims == (name,) else variable.dims):
                file[name].dims[axis].attach_scale(file[dimension])
    return buffer


def _seal(content: bytes | memoryview) -> bytes:
    return _SEAL + hashlib.sha256(content).digest()


def content_digest(data: xr.Dataset) -> str:
    """Return the SHA-256 of all names, dimensions, types, values and attributes of a dataset."""
    digest = hashlib.sha256(_attributes(data.attrs))
    for name in sorted(map(str, data.variables)):
        variable = data.variables[name]
        values = np.ascontiguousarray(variable.values)
        is_text = values.dtype.kind in "OUT"
        kind = "text" if is_text else values.dtype.newbyteorder("=").str
        digest.update(json.dumps([name, variable.dims, values.shape, kind]).encode())
        digest.update(_attributes(variable.attrs))
        digest.update(json.dumps(values.astype(str).tolist()).encode() if is_text else values.tobytes())
    return digest.hexdigest()


def _attributes(attributes: Mapping[Hashable, Any]) -> bytes:
    texts = {str(name): str(np.asarray(value).tolist()) for name, value in attributes.items()}
    return json.dumps(texts, sort_keys=True).encode()


def read_dataset(path: Path) -> tuple[xr.Dataset, str]:
    """Return the arrays of a file and the text of its scenario if both are those that were saved.

    Raises:
        FileReadError: the file is damaged, or not the result of a run.
    """
    content = read_user_file(path, limit=_MAX_BYTES, kind="a result")
    seal = content[-_SEAL_BYTES:]
    if seal.startswith(_SEAL) and seal != _seal(content[:-_SEAL_BYTES]):
        raise FileReadError(f"{path} is damaged: its checksum does not match; run its scenario again")
    try:
        with xr.open_dataset(io.BytesIO(content), engine="h5netcdf") as file:
            # Results are not compressed: only a foreign file unpacks to more than it has.
            data = file.load() if file.nbytes <= 4 * len(content) + _SLACK_BYTES else xr.Dataset()
    # The errors of xarray, h5netcdf and h5py have no common base class.
    except Exception as error:
        raise FileReadError(
            f"{path} cannot be read as netCDF ({error}); it is damaged, or is not the result.nc of a run"
        ) from None
    text = data.attrs.get("coop_pin_scenario")
    if not isinstance(text, str):
        raise FileReadError(f"{path} holds no coop_pin scenario; it was not written by coop_pin")
    digest = data.attrs.pop("coop_pin_sha256", "missing")
    if digest != content_digest(data):
        raise FileReadError(
            f"{path} is damaged, changed or of another version of coop_pin: its checksum is {digest}; run its"
            " scenario again"
        )
    del data.attrs["coop_pin_scenario"]
    return data, text


def read_run(path: Path) -> tuple[Scenario, xr.Dataset]:
    """Return the scenario and the data of a run's file, or of that in a run's folder.

    Raises:
        FileReadError: the file is missing, damaged or not a result of this version of coop_pin.
    """
    path = path / FILE if path.is_dir() else path
    if not path.is_file():
        raise FileReadError(f"there is no result file at {path}")
    data, text = read_dataset(path)
    try:
        scenario = Scenario.from_toml(text)
    except (ScenarioError, FileReadError) as error:
        unreadable = f"{path} holds a scenario that this version of coop_pin cannot read ({error})"
        command = f"coop-pin run {path.with_name('scenario.toml')} --out {path.parent}"
        raise FileReadError(f"{unreadable}; mend it and repeat it: {command}") from None
    if missing := [q.name for q in quantities(scenario) if q.stored and q.name not in data]:
        advice = "it was written by another version of coop_pin: run its scenario again"
        raise FileReadError(f"{path} lacks {', '.join(missing)}; {advice}")
    return scenario, with_names(data)
