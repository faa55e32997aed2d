"""The machine on which something is measured."""

from __future__ import annotations

import ctypes
import os
import platform
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import torch

_VERSION_LENGTH = 80  # NVML_SYSTEM_DRIVER_VERSION_BUFFER_SIZE


def describe_machine(device: torch.device) -> dict[str, Any]:
    """Device, driver, processor, versions and date, as JSON; None where unknown."""
    about: dict[str, Any] = {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "device": device.type,
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "torch": torch.__version__,
    }
    if device.type == "cuda":
        properties = torch.cuda.get_device_properties(device)
        about |= {
            "device": properties.name,
            "compute_capability": f"{properties.major}.{properties.minor}",
            "memory_gib": round(properties.total_memory / 2**30, 1),
            "driver": _driver(),
            "cuda": torch.version.cuda,
            "cudnn": torch.backends.cudnn.version(),
        }
    return about


def _processor() -> str:
    """Name of the processor: Linux has it in a file, others by `platform`."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return platform.processor()
    named = re.search(r"^model name\s*:\s*(.+)$", lines, re.MULTILINE)
    return named[1] if named else platform.machine()


def _driver() -> str | None:
    """Version of NVIDIA's driver, by its management library or, where that is not found, by the kernel's module."""
    try:
        library = ctypes.CDLL("libnvidia-ml.so.1")
        version = ctypes.create_string_buffer(_VERSION_LENGTH)
        if library.nvmlInit_v2() == 0:
            found = library.nvmlSystemGetDriverVersion(version, ctypes.c_uint(_VERSION_LENGTH)) == 0
            library.nvmlShutdown()
            if found:
                return version.value.decode()
    except (OSError, AttributeError):
        pass
    try:
        module = Path("/proc/driver/nvidia/version").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    stated = re.search(r"\b\d{3,}\.\d+(\.\d+)?\b", module)
    return stated[0] if stated else None
