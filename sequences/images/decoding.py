"""Images, compressed or raw in any of ROS' pixel encodings -> RGB."""

from __future__ import annotations

import re
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8

from filtering.errors import quoted
from sequences.errors import SequenceError
from sequences.images.headers import DamagedImageError, check_before_decoding, is_jpeg, lengthened, require_pixels

# Encoding -> element type, channels, OpenCV conversion to RGB. OpenCV's newer Bayer names (RGGB) name the mosaic
# as ROS does; its older ones (BG) name the second row, and are off by one.
_ENCODINGS: dict[str, tuple[str, int, int | None]] = {
    "rgb8": ("u1", 3, None),
    "bgr8": ("u1", 3, cv2.COLOR_BGR2RGB),
    "rgba8": ("u1", 4, cv2.COLOR_RGBA2RGB),
    "bgra8": ("u1", 4, cv2.COLOR_BGRA2RGB),
    "mono8": ("u1", 1, cv2.COLOR_GRAY2RGB),
    "8UC1": ("u1", 1, cv2.COLOR_GRAY2RGB),
    "8UC3": ("u1", 3, cv2.COLOR_BGR2RGB),
    "rgb16": ("u2", 3, None),
    "bgr16": ("u2", 3, cv2.COLOR_BGR2RGB),
    "mono16": ("u2", 1, cv2.COLOR_GRAY2RGB),
    "bayer_rggb8": ("u1", 1, cv2.COLOR_BayerRGGB2RGB),
    "bayer_bggr8": ("u1", 1, cv2.COLOR_BayerBGGR2RGB),
    "bayer_gbrg8": ("u1", 1, cv2.COLOR_BayerGBRG2RGB),
    "bayer_grbg8": ("u1", 1, cv2.COLOR_BayerGRBG2RGB),
    "bayer_rggb16": ("u2", 1, cv2.COLOR_BayerRGGB2RGB),
    "bayer_bggr16": ("u2", 1, cv2.COLOR_BayerBGGR2RGB),
    "bayer_gbrg16": ("u2", 1, cv2.COLOR_BayerGBRG2RGB),
    "bayer_grbg16": ("u2", 1, cv2.COLOR_BayerGRBG2RGB),
    "yuv422": ("u1", 2, cv2.COLOR_YUV2RGB_UYVY),
    "uyvy": ("u1", 2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422_yuy2": ("u1", 2, cv2.COLOR_YUV2RGB_YUY2),
    "yuyv": ("u1", 2, cv2.COLOR_YUV2RGB_YUY2),
}
_NAMES = {name.lower(): name for name in _ENCODINGS}
# ROS' names of matrices of numbers; those that are no encoding above hold depth, disparity or flow.
_MATRIX = re.compile(r"(8|16|32|64)[usf]c\d*", re.IGNORECASE)


def decode_image_bytes(data: bytes) -> UInt8[np.ndarray, "height width 3"]:
    """JPEG, PNG, WebP or BMP -> RGB. Orientation tags are ignored: intrinsics are of stored pixels.

    Raises DamagedImageError for a JPEG that is cut off, or whose coded pixels end early: it would decode to a grey or
    shifted image. Raises SequenceError for other bytes, and above 100 megapixels.
    """
    check_before_decoding(data)
    image = _decoded(data)
    # Where coded pixels are missing, the decoder leaves the rest grey. A camera may also see a grey corner: then more
    # coded pixels at the end change nothing.
    if is_jpeg(data) and (image[-4:, -4:] == 128).all() and not np.array_equal(image, _decoded(lengthened(data))):
        raise DamagedImageError(
            f"JPEG of {len(data)} bytes ends early, expected the pixels of all {image.shape[0]} rows"
        )
    return image


def _decoded(data: bytes) -> UInt8[np.ndarray, "height width 3"]:
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error as error:
        raise SequenceError(f"image of {len(data)} bytes cannot be decoded: {error.err}") from error
    if image is None:
        raise SequenceError(f"{len(data)} bytes are no image that OpenCV reads, expected JPEG, PNG, WebP or BMP")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)  # pyright: ignore[reportReturnType]


def decode_compressed_image(message: Any) -> UInt8[np.ndarray, "height width 3"]:
    """sensor_msgs/CompressedImage -> RGB. Raises SequenceError as `decode_image_bytes`, and for depth.

    `format` marks grey pixels as a Bayer mosaic: image_transport writes `ENCODING; png compressed ` for stored pixels,
    and `ENCODING; jpeg compressed OTHER` where it converted them to OTHER. Colours are always those of the file.
    """
    image_format: str = message.format
    source, _, rest = image_format.partition(";")
    named = [word for word in [source.strip(), *rest.split()] if word.lower() in _NAMES or _MATRIX.fullmatch(word)]
    encoding = _NAMES.get(named[-1].lower(), named[-1]) if named else ""
    _require_image(encoding)
    try:
        image = decode_image_bytes(bytes(message.data))
    except DamagedImageError:
        raise
    except SequenceError as error:
        raise SequenceError(f"{error}; its format is {quoted(message.format)}") from error
    if encoding.startswith("bayer_") and (image == image[..., :1]).all():
        return _converted(np.ascontiguousarray(image[..., :1]), encoding)
    return image


def _require_image(encoding: str) -> None:
    if encoding not in _ENCODINGS and _MATRIX.fullmatch(encoding):
        raise SequenceError(
            f"image encoding {encoding!r} is of depth or another measurement, expected a topic of images in colour or"
            " grey (--image-topic), which a grey camera publishes as mono8 or mono16"
        )


def decode_image(message: Any) -> UInt8[np.ndarray, "height width 3"]:
    """sensor_msgs/Image -> RGB; 16-bit values keep their upper 8 bits.

    Raises SequenceError for an unknown encoding or depth, too few data, or more than 100 megapixels.
    """
    height, width, step, encoding = int(message.height), int(message.width), int(message.step), message.encoding
    require_pixels(width, height, "image")
    _require_image(encoding)
    if encoding not in _ENCODINGS:
        raise SequenceError(f"image encoding {encoding!r} is not known, expected one of {', '.join(_ENCODINGS)}")
    kind, channels, _ = _ENCODINGS[encoding]
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    row = width * channels * dtype.itemsize
    if height < 1 or width < 1 or step < row or len(message.data) < step * (height - 1) + row:
        raise SequenceError(
            f"image of {width} x {height} {encoding} has {len(message.data)} bytes in rows of {step},"
            f" expected {row * height} or more in rows of {row} or more"
        )
    # The last row may lack the padding that the others have.
    data = np.frombuffer(message.data, np.uint8, count=step * (height - 1) + row)
    pixels = np.lib.stride_tricks.as_strided(data, (height, row), (step, 1), writeable=False)
    pixels = np.ascontiguousarray(pixels).view(dtype).reshape(height, width, channels)
    return _converted((pixels >> 8).astype(np.uint8) if dtype.itemsize == 2 else pixels, encoding)


def _converted(
    pixels: UInt8[np.ndarray, "height width channels"], encoding: str
) -> UInt8[np.ndarray, "height width 3"]:
    conversion = _ENCODINGS[encoding][2]
    if conversion is None:
        return np.array(pixels)  # the message's own bytes are not writeable
    try:
        return cv2.cvtColor(pixels, conversion)  # pyright: ignore[reportReturnType]
    except cv2.error as error:
        raise SequenceError(
            f"image of {pixels.shape[1]} x {len(pixels)} {encoding} cannot be converted: {error.err}"
        ) from error
