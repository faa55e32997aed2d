"""The cameras of a recording or a running system: which image topics they are, and where each is mounted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from filtering.errors import few
from filtering.se3 import Poses
from sequences.errors import NotFoundError, SequenceError
from sequences.images.decoding import decode_compressed_image, decode_image
from sequences.images.video import ImageStream, Video
from sequences.options import ReadingOptions
from sequences.reading.extrinsics import Extrinsics, find_extrinsics
from sequences.recordings.messages import frame_name
from sequences.recordings.source import MessageSource, Topic, choose, first, listing

_IMAGE_STREAMS: dict[str, Callable[[], ImageStream]] = {
    "sensor_msgs/Image": partial(ImageStream, decode_image),
    "sensor_msgs/CompressedImage": partial(ImageStream, decode_compressed_image),
    "foxglove_msgs/CompressedVideo": partial(Video, "format"),
    "ffmpeg_image_transport_msgs/FFMPEGPacket": partial(Video, "encoding"),
}
IMAGE_TYPES = tuple(_IMAGE_STREAMS)
_INFO_TYPES = ("sensor_msgs/CameraInfo",)
_TRANSPORTS = ("compressed", "ffmpeg", "foxglove")  # by the habit of image_transport, the last part of a topic's name
_NAMED = 3  # cameras to choose from, in an error
_DEPTH, _GREY = ("16uc1", "32fc1", "64fc1"), ("mono", "8uc1")  # how encodings begin


@dataclass(frozen=True)
class CameraTopics:
    """The topics of one camera, and its mount.

    Attributes:
        image: Of its images.
        info: Of its intrinsics; None where there is none.
        mount: reference_from_camera: where it is fixed on the first camera, whose pose is localized.
    """

    image: Topic
    info: Topic | None
    mount: Extrinsics

    @property
    def name(self) -> str:
        """Its name: that of its images' topic."""
        return self.image.name

    def open_images(self, path: object) -> ImageStream:
        """A new stream of the images. Raises SequenceError where PyAV is missing."""
        try:
            return _IMAGE_STREAMS[self.image.read_as]()
        except SequenceError as error:
            raise SequenceError(f"{path}: {self.name} ({self.image.type}): {error}") from error


def find_cameras(
    bag: MessageSource, options: ReadingOptions, usual: Sequence[str] = ()
) -> tuple[list[CameraTopics], list[str]]:
    """The cameras that the options name, the first of which is localized, or else all that belong together.

    Of several topics that nobody named the `usual` ones are taken, as far as there are any. Else depth is left out, and
    grey cameras where there are cameras in colour; the others need a frame each, and transforms between these.

    Returns:
        The cameras, at least one, and sentences for users about topics that were left out.

    Raises:
        NotFoundError: there is no topic of images, or tf does not lead from one camera to another.
        SequenceError: a topic is no camera, or there is a choice to make.
    """
    named, notices = options.image_topics, list[str]()
    if named:
        images = [_chosen(bag, name) for name in named]
    else:
        images = [topic for topic in bag.topics.values() if topic.read_as in IMAGE_TYPES and topic.num_messages]
        images = sorted(images, key=lambda topic: topic.name)
        if len(images) > 1:
            known = [image for name in usual for image in images if image.name == name]
            if known:
                others = [image.name for image in images if image not in known]
                missing = [name for name in usual if name not in bag.topics]
                notices = [f"images of {', '.join(others)} are not used, as the model did not learn from them"] * any(
                    others
                )
                notices += [f"no images of {', '.join(missing)}, which the model learned from, too"] * any(missing)
                images = known
            else:
                images, notices = _of_one_kind(bag, images)
        if len(images) < 2:
            images = [_chosen(bag, images[0].name if images else None)]
    return [_with_mount(bag, options, image, images[0], others=len(images) > 1) for image in images], notices


def _chosen(bag: MessageSource, name: str | None) -> Topic:
    image = choose(bag, "image", IMAGE_TYPES, name, required=True)
    assert image is not None
    return image


def _of_one_kind(bag: MessageSource, images: Sequence[Topic]) -> tuple[list[Topic], list[str]]:
    """The topics that are cameras of one kind, each in a frame of its own, and notices about the others."""
    encodings, frames = {}, {}
    for image in images:
        try:
            message = first(bag, image)
        except SequenceError:
            continue  # nothing on it can be read
        encodings[image.name] = str(getattr(message, "encoding", getattr(message, "format", ""))).lower()
        frames[image.name] = frame_name(message.header.frame_id)
    cameras = [each for each in images if not encodings.get(each.name, _DEPTH[0]).startswith(_DEPTH)]
    in_colour = [each for each in cameras if not encodings[each.name].startswith(_GREY)]
    kept = in_colour or cameras or list(images)
    if len(kept) > 1:
        shared = [name for name, count in Counter(frames.get(each.name, "") for each in kept).items() if count > 1]
        apart = [each for each in kept[1:] if not shared and not _is_connected(bag, frames, kept[0], each)]
        if shared:
            of_one = ", ".join(each.name for each in kept if frames.get(each.name, "") == shared[0])
            raise SequenceError(
                f"{bag.path}: {len(kept)} image topics, of which {of_one} are of one frame, {shared[0]!r}; expected one"
                f" for each camera; name one, or several separated by commas, by --image-topic; {listing(kept)}"
            )
        if apart:
            ends = f"{frames[kept[0].name]!r} ({kept[0].name}) and {frames.get(apart[0].name, '')!r} ({apart[0].name})"
            choices = " or ".join(few((f"--image-topic {each.name}" for each in kept), _NAMED))
            raise SequenceError(
                f"{bag.path}: {len(kept)} image topics, and no transforms between {ends}; expected one camera, or"
                f" several that tf connects, separated by commas: {choices}"
            )
    notices = []
    for image in (each for each in images if each not in kept):
        encoding = encodings.get(image.name)
        why = "nothing on it can be read" if encoding is None else "depth" if encoding.startswith(_DEPTH) else "grey"
        notices.append(f"images of {image.name} are not used ({why}): --image-topic names others")
    return kept, notices


def _is_connected(bag: MessageSource, frames: dict[str, str], one: Topic, other: Topic) -> bool:
    try:
        find_extrinsics(bag, frames[one.name], frames[other.name])
    except (NotFoundError, KeyError):
        return False
    return True


def _with_mount(
    bag: MessageSource, options: ReadingOptions, image: Topic, reference: Topic, *, others: bool
) -> CameraTopics:
    mount = Extrinsics(Poses.identity())
    if image is not reference:
        frame = frame_name(options.camera_frame or first(bag, reference).header.frame_id)
        mount = find_extrinsics(
            bag,
            frame,
            frame_name(first(bag, image).header.frame_id),
            body_is=f" ({reference.name})",
            camera_is=f" ({image.name})",
            instead="a single --image-topic",
        )
    # By the habit of ROS and of Foxglove, the intrinsics lie beside the image topic.
    parts = image.name.split("/")
    folder = "/".join(parts[: -2 if parts[-1] in _TRANSPORTS else -1])
    name = next((name for name in (f"{folder}/camera_info", f"{folder}/calibration") if name in bag.topics), None)
    if others:
        info = (
            None if name is None or options.camera_info_topic == "" else choose(bag, "camera-info", _INFO_TYPES, name)
        )
    else:
        given = options.camera_info_topic
        info = choose(bag, "camera-info", _INFO_TYPES, name if given is None else given)
    return CameraTopics(image, info, mount)
