"""Damage to files of every kind: by disks and transfers, by programs that err, and by people who edit."""

import base64
import io
import json
import math
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import PurePath
from typing import Any

import numpy as np
import torch
from safetensors.torch import load, save
from torch import Tensor

from tests.helpers.exported import metadata_of, put_together, take_apart, with_arrays, with_digest
from vapor.engines import onnx_file
from vapor.engines.onnx_file import ARRAYS, CONFIG
from vapor.tensor_files import CHECKSUM, content_sha256

Rng = np.random.Generator
Damage = Callable[[bytes, Rng], tuple[bytes, str]]
"""The bytes of a whole file -> of a damaged one, and a description of the damage."""

NUMBERS = (0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 10**6, 2**31 - 1, 2**31, 2**32 - 1, 10**15, 2**63 - 1, 2**64 - 1)
"""Critical lengths, offsets and counts."""

WORDS = (
    *("nan", "inf", "-inf", "0", "-0", "-1", "0.5", "1e-320", "1e308", "-1e308", "1e400", "1e999999", "1e-999999"),
    *("9" * 25, "9" * 5000, "1700000000123456789", "1700000000123456", "1_0", "0x10", "1e3", "٣", "1,5", "true"),
    *("", "x", "#", "\0", "\n", "\ufeff", "\ud800", "..", "../../../etc/hostname", "/", "/dev/zero", "a" * 100_000),
    *("[", "]", "{", "}", '"', "'", ":", "- ", "&a [*a]", "!!python/object/apply:os.getcwd []", "~", "🙂", "\u2028"),
)
"""In place of a number or a name."""


def damaged_bytes(data: bytes, rng: Rng) -> tuple[bytes, str]:
    """Damage that needs no knowledge of the format."""
    size = len(data)
    at, start = int(rng.integers(size + 1)), int(rng.integers(size + 1))
    length = min(int(2 ** rng.uniform(0, np.log2(size + 2))), size - at)  # 1 or more, but at the end
    before, cut, after = data[:at], data[at : at + length], data[at + length :]
    extra = rng.bytes(int(rng.integers(1, 65)))
    bit, value, width = 1 << int(rng.integers(8)), pick(rng, NUMBERS), pick(rng, (2, 4, 8))
    number = (value % 256**width).to_bytes(width, pick(rng, ("little", "big")))
    choices = (
        (
            before + bytes([each ^ bit for each in data[at : at + 1]]) + data[at + 1 :],
            f"bit {bit} of byte {at} flipped",
        ),
        (before + extra[:8] + data[at + len(extra[:8]) :], f"{len(extra[:8])} random bytes at {at}"),
        (before + number + data[at + width :], f"the number {value} in {width} bytes at {at}"),
        (before, f"cut at byte {at} of {size}"),
        (before + after, f"bytes {at} to {at + length} left out"),
        (before + cut + cut + after, f"bytes {at} to {at + length} twice"),
        (before + bytes(length) + after, f"bytes {at} to {at + length} zeroed"),
        (before + extra + cut + after, f"{len(extra)} bytes inserted at {at}"),
        (before + data[start : start + length] + after, f"bytes of {start} at {at}, {length} of them"),
    )
    return pick(rng, choices)


def damaged_text(data: bytes, rng: Rng) -> tuple[bytes, str]:
    """Lines and words: lost, repeated, in another order, or others in their place."""
    text = data.decode("utf-8", "surrogateescape")
    kind = int(rng.integers(10))
    if kind < 5 and (words := [*re.finditer(r"[^\s,;:\[\]{}\"']+", text)]):
        found = pick(rng, words)
        word = pick(rng, WORDS)
        changed = text[: found.start()] + word + text[found.end() :]
        note = f"{short(found[0])} became {short(word)}"
    elif kind < 9 and (lines := text.splitlines(keepends=True)):
        i, j = int(rng.integers(len(lines))), int(rng.integers(len(lines)))
        line, note = lines[i], f"lines {i + 1} and {j + 1} exchanged"
        if kind == 6:
            note = f"line {i + 1} left out"
            del lines[i]
        elif kind == 7:
            note = f"line {i + 1} again as line {j + 1}"
            lines.insert(j, line)
        else:
            lines[i], lines[j] = lines[j], line
        changed = "".join(lines)
    else:
        return damaged_bytes(data, rng)
    return changed.encode("utf-8", "surrogatepass" if "\ud800" in changed else "surrogateescape"), note


def damaged_json(data: bytes, rng: Rng) -> tuple[bytes, str]:
    """One value of a document: of another kind, gone, far too large, or nested without end."""
    try:
        document = json.loads(data)
    except (ValueError, RecursionError):
        return damaged_text(data, rng)
    holders = [*_holders(document)]
    if not holders or rng.random() < 0.15:
        return damaged_text(data, rng)
    holder, key = pick(rng, holders)
    before, kind, raw = holder[key], int(rng.integers(8)), None
    note = f"{key!r} left out"
    if kind == 0:
        del holder[key]
    elif kind == 1:
        holder[key] = pick(rng, holders)[0]
        if holder[key] is holder or any(each is holder or each[k] is holder for each, k in _holders(holder[key])):
            holder[key] = [before]
        note = f"{key!r} became another part of the document"
    elif kind == 2 and isinstance(before, list):
        holder[key] = before + before if rng.random() < 0.5 else before[: int(rng.integers(len(before) + 1))]
        note = f"{key!r} with {len(holder[key])} items for {len(before)}"
    else:
        raw = pick(rng, _JSON_VALUES)
        if kind < 5 and isinstance(before, int | float) and not isinstance(before, bool):
            raw = json.dumps(pick(rng, (before * 1000, before / 1000, -before, before + 1, before * 10.0**300)))
        holder[key], note = "\0here\0", f"{key!r} became {short(raw)}"
    text = json.dumps(document)
    return (text if raw is None else text.replace(json.dumps("\0here\0"), raw)).encode(), note


_JSON_VALUES = (
    *("NaN", "Infinity", "-Infinity", "0", "-1", "1e999", "1e400", "0.5", "1" + "0" * 400, "9" * 5000, "true", "null"),
    *('""', '"x"', '"' + "a" * 100_000 + '"', '"\\ud800"', '"\\u0000"', '"../../../etc/hostname"', '"/dev/zero"'),
    *("[]", "{}", "[" * 100_000, "[" * 900 + "]" * 900, '{"a":' * 100_000, "[[]]", '{"x": 1}', '{"__class__": 1}'),
)


def _holders(value: Any) -> Any:
    """Every list and object of a document with each of its keys."""
    keys = value.keys() if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    for key in list(keys):
        yield value, key
        yield from _holders(value[key])


def damaged_png(data: bytes, rng: Rng) -> tuple[bytes, str]:
    """Bytes of an image; of a PNG also what its header says, under a checksum that is right."""
    if rng.random() < 0.6 or data[:4] != b"\x89PNG":
        return damaged_bytes(data, rng)
    at, value = int(rng.choice([16, 20])), pick(rng, NUMBERS) % 2**32
    header = bytearray(data[12:29])
    if rng.random() < 0.7:
        header[at - 12 : at - 8] = value.to_bytes(4, "big")
        note = f"PNG of {'width' if at == 16 else 'height'} {value}"
    else:
        header[12:15] = bytes(int(rng.choice([0, 1, 2, 3, 4, 6, 8, 16, 255])) for _ in range(3))
        note = f"PNG of depth, colours and compression {tuple(header[12:15])}"
    return data[:12] + bytes(header) + zlib.crc32(header).to_bytes(4, "big") + data[33:], note


def damaged_zip(data: bytes, rng: Rng) -> tuple[bytes, str]:
    """An archive with a member that is damaged, under a checksum that is right."""
    if rng.random() < 0.4:
        return damaged_bytes(data, rng)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = pick(rng, [*members])
    if rng.random() < 0.6:
        name = next((each for each in members if "metadata" in each), name)
    members[name], note = damage_of(f"{name}.json" if "metadata" in name else name)(members[name], rng)
    return zipped(members), f"{name}: {note}"


def zipped(members: dict[str, bytes]) -> bytes:
    """An archive that is the same whenever it is made."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in members.items():
            archive.writestr(zipfile.ZipInfo(name), content)
    return stream.getvalue()


def damaged_model(data: bytes, rng: Rng) -> tuple[bytes, str]:
    """A safetensors file: its header, the configuration in that, or its tensors; mostly with a checksum that fits."""
    damaged, note = _damaged_model(data, rng)
    if rng.random() < 0.7 and (fitting := with_checksum(damaged)) is not None:
        return fitting, f"{note}, checksum made to fit"
    return damaged, note


def with_checksum(data: bytes) -> bytes | None:
    """A safetensors file whose checksum is of what it says now; None where it is no such file any more."""
    try:
        (length,) = struct.unpack("<Q", data[:8])
        header, tensors = json.loads(data[8 : 8 + length]), load(data)
        header["__metadata__"][CHECKSUM] = content_sha256(tensors, header["__metadata__"])
        return _model(json.dumps(header).encode(), data[8 + length :])
    except Exception:  # of the library, or of any damage
        return None


def in_order(data: bytes) -> bytes:
    """A safetensors file whose header is in the order of names: the library writes metadata in any."""
    (length,) = struct.unpack("<Q", data[:8])
    header = json.dumps(json.loads(data[8 : 8 + length]), sort_keys=True)
    return _model(header.encode(), data[8 + length :])


def _damaged_model(data: bytes, rng: Rng) -> tuple[bytes, str]:
    kind = int(rng.integers(8))
    (length,) = struct.unpack("<Q", data[:8])
    header, tensors = data[8 : 8 + length], data[8 + length :]
    content = json.loads(header)
    metadata = content["__metadata__"]
    if kind == 0:
        return damaged_bytes(data, rng)
    if kind == 1:
        value = pick(rng, (*NUMBERS, length - 1, length + 1, len(data)))
        return struct.pack("<Q", value) + data[8:], f"a header of {value} bytes"
    if kind == 2:
        header, note = damaged_json(header, rng)
        return _model(header, tensors), f"header: {note}"
    if kind == 3:
        name = pick(rng, [*metadata])
        text, note = damaged_json(metadata[name].encode(), rng)
        metadata[name] = text.decode("utf-8", "replace")
        return _model(json.dumps(content).encode(), tensors), f"{name} in the metadata: {note}"
    name = pick(rng, [each for each in content if each != "__metadata__"])
    if kind < 6:
        return _with_other_tensor(load(data), metadata, name, rng)
    begin, end = content[name]["data_offsets"]
    values, note = damaged_bytes(tensors[begin:end], rng)
    values = values[: end - begin].ljust(end - begin, b"\0")
    return data[: 8 + length] + tensors[:begin] + values + tensors[end:], f"tensor {name}: {note}"


def _with_other_tensor(tensors: dict[str, Tensor], metadata: dict[str, str], name: str, rng: Rng) -> tuple[bytes, str]:
    """A file of tensors of which one is gone, or has another name, type, shape or content."""
    before = tensors.pop(name)
    flat = before.flatten()
    number = pick(rng, (math.nan, math.inf, -math.inf, 6e4, -1.0, 0.0) if before.is_floating_point() else (-1, 2**40))
    one_other = before.clone()
    one_other.view(-1)[int(rng.integers(max(before.numel(), 1))) :][:1] = number
    types = (torch.float64, torch.float16, torch.bfloat16, torch.int8, torch.int64, torch.bool, torch.complex64)
    shapes = (flat, before[None], flat[:0], flat[:1], torch.cat([flat, flat]), flat.reshape(before.shape[::-1]))
    new_name, other = name + pick(rng, ("x", ".", "\0", "9" * 5000)), pick(rng, [*tensors])
    changed, note = pick(
        rng,
        (
            ({}, "gone"),
            ({new_name: before}, "with another name"),
            ({name: before.to(kind := pick(rng, types))}, f"as {kind}"),
            ({name: (shaped := pick(rng, shapes))}, f"became {list(shaped.shape)}"),
            ({name: one_other}, f"with the number {number}"),
            ({name: tensors[other].clone()}, f"became {other}"),
        ),
    )
    content = {each: value.contiguous() for each, value in (tensors | changed).items()}
    return in_order(save(content, metadata)), f"tensor {name} of {list(before.shape)} {note}"


def _model(header: bytes, tensors: bytes) -> bytes:
    return struct.pack("<Q", len(header)) + header + tensors


def damaged_onnx(data: bytes, rng: Rng) -> tuple[bytes, str]:
    """An exported model: its bytes, graph, metadata or tensors; mostly under a digest that fits."""
    kind = int(rng.integers(8))
    if kind == 0:
        return damaged_bytes(data, rng)
    if kind > 5:
        return _with_other_description(data, rng)
    graph, entries = take_apart(data)
    number = int(rng.integers(len(entries)))
    name, text = entries[number]
    words = name.decode()
    if kind == 1:
        graph, note = damaged_bytes(graph, rng)
        note = f"graph: {note}"
    elif kind == 2:
        size = onnx_file._as_varint(pick(rng, (*NUMBERS, len(data), len(data) - 1)))
        graph = b"\x3a" + (size if rng.random() < 0.7 else b"\xff" * 1000) + graph[8:]
        note = "a graph of another length"
    elif kind == 3:
        other = [entries[:number] + entries[number + 1 :], [*entries, (name, text)], [*entries, entries[number - 1]]]
        entries, note = pick(rng, (*other, entries[::-1])), f"{words} gone, twice or in another order"
    elif kind == 4:
        name, note = damaged_bytes(name, rng)
        entries[number], note = (name, text), f"name {words}: {note}"
    else:
        text, note = (damaged_json if words == CONFIG else damaged_bytes)(text, rng)
        entries[number], note = (name, text), f"{words}: {note}"
    if rng.random() < 0.7:
        return with_digest(graph, entries), f"{note}, digest made to fit"
    return put_together(graph, entries), note


def _with_other_description(data: bytes, rng: Rng) -> tuple[bytes, str]:
    """An exported model whose tensors and settings are damaged, mostly with settings for all to read that fit."""
    arrays, note = damaged_model(base64.b64decode(dict(take_apart(data)[1])[ARRAYS.encode()]), rng)
    changed = with_arrays(data, lambda _: arrays)
    try:
        config = metadata_of(arrays)["config"].encode("utf-8", "replace")
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError, struct.error):  # no settings any more
        return changed, note
    graph, entries = take_apart(changed)
    if rng.random() < 0.9:
        entries = [(name, config if name == CONFIG.encode() else text) for name, text in entries]
    return put_together(graph, entries), note


def damage_of(name: str) -> Damage:
    """How to damage a file of this name."""
    from tests.fuzz.mcap_damage import damaged_mcap  # which damages what messages hold by this

    kinds: dict[str, Damage] = {
        **dict.fromkeys((".txt", ".csv", ".yaml", ".tum"), damaged_text),
        ".json": damaged_json,
        ".png": damaged_png,
        ".r3d": damaged_zip,
        ".safetensors": damaged_model,
        ".onnx": damaged_onnx,
        ".mcap": damaged_mcap,
    }
    return kinds.get(PurePath(name).suffix, damaged_bytes)


def pick(rng: Rng, choices: Any) -> Any:
    """One of a sequence, as it is (numpy would make arrays of tuples)."""
    return choices[int(rng.integers(len(choices)))]


def short(text: str) -> str:
    """At most forty characters of it."""
    return repr(text) if len(text) <= 40 else f"{text[:20]!r}... of {len(text)}"
