"""Images of every encoding -> RGB, and images that are refused."""

import struct
import zlib
from collections.abc import Sequence
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from sequences.errors import SequenceError
from sequences.images.decoding import decode_compressed_image, decode_image, decode_image_bytes
from sequences.images.headers import DamagedImageError
from tests.helpers.tf_files import image_message

RGB = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)
GREY = np.repeat(RGB[..., :1], 3, axis=2)
ALPHA = np.full((6, 8, 1), 7, np.uint8)
BGR, RGBA, BGRA = RGB[..., ::-1], np.concatenate([RGB, ALPHA], 2), np.concatenate([RGB[..., ::-1], ALPHA], 2)
LAYOUTS_OF_BYTES = {"rgb8": RGB, "bgr8": BGR, "8UC3": BGR, "rgba8": RGBA, "bgra8": BGRA}
LAYOUTS_OF_WORDS = {"rgb16": RGB, "bgr16": BGR}
LAYOUTS = {name: (pixels, RGB) for name, pixels in LAYOUTS_OF_BYTES.items()}
LAYOUTS |= {name: (pixels.astype(np.uint16) * 256 + 99, RGB) for name, pixels in LAYOUTS_OF_WORDS.items()}
LAYOUTS |= {"mono8": (RGB[..., 0], GREY), "8UC1": (RGB[..., 0], GREY)}
LAYOUTS |= {"mono16": (RGB[..., 0].astype(np.uint16) * 256 + 99, GREY)}


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize("encoding", LAYOUTS)
def test_raw_images_become_rgb_whatever_their_layout_and_padding(encoding: str, padding: int) -> None:
    pixels, expected = LAYOUTS[encoding]
    big_endian = pixels.dtype.itemsize == 2 and padding == 5
    image = decode_image(image_message(pixels, encoding, padding=padding, big_endian=big_endian))
    np.testing.assert_array_equal(image, expected)
    assert image.flags.writeable


# Colour of the four pixels of a tile, row by row: 0 red, 1 green, 2 blue.
MOSAICS = {
    "bayer_rggb": [0, 1, 1, 2],
    "bayer_bggr": [2, 1, 1, 0],
    "bayer_gbrg": [1, 2, 0, 1],
    "bayer_grbg": [1, 0, 2, 1],
}


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("pattern", MOSAICS)
def test_a_mosaic_made_by_hand_gets_its_colour_back(pattern: str, bits: int) -> None:
    colour = np.array([200, 120, 30])
    tile = colour[MOSAICS[pattern]].reshape(2, 2)
    mosaic = np.tile(tile, (8, 8)).astype(np.uint8)
    pixels = mosaic if bits == 8 else mosaic.astype(np.uint16) * 256
    image = decode_image(image_message(pixels, f"{pattern}{bits}"))
    np.testing.assert_array_equal(image[2:-2, 2:-2], np.broadcast_to(colour, (12, 12, 3)))


def narrow_yuv(colour: np.ndarray) -> np.ndarray:
    """BT.601 in the narrow range of video."""
    y, v, u = cv2.cvtColor(colour[None, None], cv2.COLOR_RGB2YCrCb)[0, 0].astype(float)
    yuv = [16 + y * 219 / 255, 128 + (u - 128) * 224 / 255, 128 + (v - 128) * 224 / 255]
    return np.round(yuv).astype(np.uint8)


@pytest.mark.parametrize("padding", [0, 4])
@pytest.mark.parametrize(
    ("encoding", "order"), [("yuv422", "uyvy"), ("uyvy", "uyvy"), ("yuv422_yuy2", "yuyv"), ("yuyv", "yuyv")]
)
def test_yuv_images_get_their_colour_back(encoding: str, order: str, padding: int) -> None:
    colour = np.array([180, 60, 90], np.uint8)
    values = narrow_yuv(colour)[["yuv".index(letter) for letter in order]].reshape(2, 2)
    image = decode_image(image_message(np.tile(values, (4, 4, 1)), encoding, padding=padding))
    np.testing.assert_allclose(image.reshape(-1, 3), np.broadcast_to(colour, (32, 3)), atol=6)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"encoding": "mono12"}, "encoding 'mono12' is not known, expected one of rgb8"),
        ({"encoding": "32FC1"}, "encoding '32FC1' is of depth .*--image-topic.* mono8 or mono16"),
        ({"encoding": "16UC1"}, "encoding '16UC1' is of depth"),
        ({"data": b"123"}, "3 bytes"),
        ({"step": 5}, "rows of 5"),
        ({"height": 0}, "8 x 0"),
        ({"encoding": "yuv422", "width": 7}, "cannot be converted"),
    ],
)
def test_raw_images_that_cannot_be_are_named(change: dict, said: str) -> None:
    message = image_message(RGB, "rgb8")
    message.__dict__.update(change)
    with pytest.raises(SequenceError, match=said):
        decode_image(message)


SMOOTH = cv2.GaussianBlur(cv2.resize(RGB, (32, 24), interpolation=cv2.INTER_LINEAR), (0, 0), 3)


def mosaic_of(rgb: np.ndarray, pattern: str) -> np.ndarray:
    """What a sensor behind a colour filter sees."""
    rows, columns = np.indices(rgb.shape[:2])
    return np.take_along_axis(rgb, np.array(MOSAICS[pattern])[rows % 2 * 2 + columns % 2][..., None], axis=2)[..., 0]


@pytest.mark.parametrize("pattern", MOSAICS)
@pytest.mark.parametrize(
    ("image_format", "bits", "within"),
    [
        ("{pattern}8; png compressed ", 8, 4),
        ("{pattern}8; png", 8, 4),
        ("{pattern}16; png compressed ", 16, 4),
        ("{pattern}8; jpeg compressed ", 8, 12),
        ("{pattern}8; jpeg compressed {pattern}8", 8, 12),
    ],
)
def test_a_mosaic_that_a_format_names_gets_its_colour_back(
    pattern: str, image_format: str, bits: int, within: float
) -> None:
    mosaic = mosaic_of(SMOOTH, pattern)
    pixels = mosaic if bits == 8 else mosaic.astype(np.uint16) * 256 + 99
    data = cv2.imencode(".jpg" if "jpeg" in image_format else ".png", pixels)[1].tobytes()
    image = decode_compressed_image(SimpleNamespace(data=data, format=image_format.format(pattern=pattern)))
    off = np.abs(image.astype(int) - SMOOTH)[2:-2, 2:-2]
    assert off.mean() < within
    raw = decode_image(image_message(pixels, f"{pattern}{bits}"))
    assert "jpeg" in image_format or np.array_equal(image, raw)


@pytest.mark.parametrize(
    ("image_format", "pixels", "expected"),
    [
        ("bayer_rggb8; jpeg compressed mono8", SMOOTH[..., 0], np.repeat(SMOOTH[..., :1], 3, axis=2)),  # grey by then
        ("bayer_rggb8; png compressed bgr8", SMOOTH[..., ::-1], SMOOTH),
        ("bayer_rggb8; png compressed ", SMOOTH[..., ::-1], SMOOTH),  # in colour, whatever is said
        ("rgb8; jpeg compressed bgr8", SMOOTH[..., ::-1], SMOOTH),
        ("bgr8; png compressed rgb8", SMOOTH[..., ::-1], SMOOTH),
        ("rgba8; png compressed bgra8", cv2.cvtColor(SMOOTH, cv2.COLOR_RGB2BGRA), SMOOTH),
        ("rgb16; png compressed bgr16", SMOOTH[..., ::-1].astype(np.uint16) * 256 + 9, SMOOTH),
        ("8UC3; png", SMOOTH[..., ::-1], SMOOTH),
        ("mono16; png", RGB[..., 0].astype(np.uint16) * 256 + 99, GREY),
        ("", RGB[..., 0], GREY),
    ],
)
def test_colours_of_compressed_images_are_those_of_the_file(
    image_format: str, pixels: np.ndarray, expected: np.ndarray
) -> None:
    suffix = ".jpg" if "jpeg" in image_format else ".png"
    message = SimpleNamespace(data=cv2.imencode(suffix, pixels)[1].tobytes(), format=image_format)
    within = 12 if suffix == ".jpg" else 0
    np.testing.assert_allclose(decode_compressed_image(message).astype(int), expected, atol=within)


@pytest.mark.parametrize("image_format", ["32FC1; compressedDepth png", "16uc1; png"])
def test_depth_is_refused_by_its_encoding(image_format: str) -> None:
    data = cv2.imencode(".png", RGB[..., 0].astype(np.uint16))[1].tobytes()
    with pytest.raises(SequenceError, match=f"'{image_format[:5]}' is of depth .* expected a topic of images"):
        decode_compressed_image(SimpleNamespace(data=data, format=image_format))


def test_a_compressed_image_of_another_kind_is_refused_with_its_format() -> None:
    tiff = cv2.imencode(".tiff", RGB)[1].tobytes()
    with pytest.raises(SequenceError, match=r"expected JPEG, PNG, WebP or BMP; its format is 'rgb8; tiff compressed '"):
        decode_compressed_image(SimpleNamespace(data=tiff, format="rgb8; tiff compressed "))


def jpeg_of_noise(options: Sequence[int] = ()) -> bytes:
    noise = np.random.default_rng(1).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    return cv2.imencode(".jpg", noise, options)[1].tobytes()


@pytest.mark.parametrize("data", [b"", b"no image", b"\xff\xd8\xff", b"BM", b"\x89PNG\r\n\x1a\n" + bytes(40)])
def test_compressed_images_that_are_none_are_refused(data: bytes) -> None:
    with pytest.raises(SequenceError) as caught:
        decode_image_bytes(data)
    assert not isinstance(caught.value, DamagedImageError)


@pytest.mark.parametrize("options", [[], [cv2.IMWRITE_JPEG_RST_INTERVAL, 3]])
def test_a_jpeg_that_lacks_pixels_is_damaged_though_it_decodes(options: list[int]) -> None:
    whole = jpeg_of_noise(options)
    assert decode_image_bytes(whole).shape == (64, 64, 3)
    middle = len(whole) // 2
    assert whole.rindex(b"\xff\xda") < len(whole) - 500
    for damaged in (
        whole[:middle],  # cut off
        whole[: whole.index(b"\xff\xda") + 400] + b"\xff\xd9",  # and closed again
        whole[:-300] + b"\xff\x37" + whole[-298:],  # a marker that cannot be there
    ):
        with pytest.raises(DamagedImageError, match="JPEG of"):
            decode_image_bytes(damaged)


def test_a_jpeg_with_a_grey_corner_is_whole() -> None:
    grey = np.full((64, 64, 3), 128, np.uint8)
    np.testing.assert_array_equal(decode_image_bytes(cv2.imencode(".jpg", grey)[1].tobytes()), grey)


def of_size(kind: str, width: int, height: int) -> bytes:
    """An image that states another size than it has."""
    data = bytearray(jpeg_of_noise() if kind == "jpg" else cv2.imencode(f".{kind}", RGB)[1].tobytes())
    if kind == "jpg":
        at = data.index(b"\xff\xc0") + 5
        data[at : at + 4] = struct.pack(">HH", height, width)
    elif kind == "png":
        data[16:24] = struct.pack(">II", width, height)
        data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    elif kind == "bmp":
        data[18:26] = struct.pack("<ii", width, -height)
    else:
        assert data[12:16] == b"VP8L"
        data[21:25] = struct.pack("<I", (width - 1) | (height - 1) << 14)
    return bytes(data)


@pytest.mark.parametrize("kind", ["jpg", "png", "bmp", "webp"])
def test_an_image_that_states_more_than_a_hundred_megapixels_is_not_decoded(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    size = (60_000, 60_000) if kind != "webp" else (16_000, 16_000)
    monkeypatch.setattr(cv2, "imdecode", None)
    with pytest.raises(SequenceError, match=rf"image: {size[0]} x {size[1]} pixels, expected at most 100 megapixels"):
        decode_image_bytes(of_size(kind, *size))


def test_lossy_and_extended_webp_state_their_size() -> None:
    lossy = cv2.imencode(".webp", np.zeros((20, 30, 3), np.uint8), [cv2.IMWRITE_WEBP_QUALITY, 50])[1].tobytes()
    assert lossy[12:16] == b"VP8 "
    assert decode_image_bytes(lossy).shape == (20, 30, 3)
    size = (20_000 - 1).to_bytes(3, "little")
    with pytest.raises(SequenceError, match="image: 20000 x 20000 pixels"):
        decode_image_bytes(b"RIFF0000WEBPVP8X" + bytes(8) + size + size)


def test_a_raw_image_of_more_than_a_hundred_megapixels_is_refused() -> None:
    message = image_message(RGB, "rgb8")
    message.width = message.height = 10_001
    with pytest.raises(SequenceError, match="10001 x 10001 pixels, expected at most 100 megapixels"):
        decode_image(message)


def test_a_jpeg_of_more_scans_than_any_camera_writes_is_refused() -> None:
    data = jpeg_of_noise([cv2.IMWRITE_JPEG_PROGRESSIVE, 1])
    assert decode_image_bytes(data).shape == (64, 64, 3)
    last = data[data.rindex(b"\xff\xda") : -2]
    with pytest.raises(SequenceError, match="more than 100 scans"):
        decode_image_bytes(data[:-2] + 100 * last + data[-2:])
