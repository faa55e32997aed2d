"""sensor_msgs/Image of given pixels."""

from types import SimpleNamespace

import numpy as np


def image_message(pixels: np.ndarray, encoding: str, *, padding: int = 0, big_endian: bool = False) -> SimpleNamespace:
    """A sensor_msgs/Image whose rows end in `padding` bytes of rubbish."""
    rows = pixels.astype(pixels.dtype.newbyteorder(">" if big_endian else "<"), copy=False)
    rows = np.frombuffer(np.ascontiguousarray(rows).tobytes(), np.uint8).reshape(len(pixels), -1)
    rows = np.concatenate([rows, np.full((len(rows), padding), 123, np.uint8)], axis=1)
    return SimpleNamespace(
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=int(big_endian),
        step=rows.shape[1],
        data=rows.tobytes(),
    )
