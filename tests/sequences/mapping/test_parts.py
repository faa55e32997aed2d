"""Which images of a model hold together."""

from types import SimpleNamespace

from sequences.mapping.colmap import _held_together


def model_of(*shared: tuple[int, tuple[int, ...]]):
    """A model in which so many points are seen by these images."""
    tracks = [images for count, images in shared for _ in range(count)]
    points = {
        number: SimpleNamespace(track=SimpleNamespace(elements=[SimpleNamespace(image_id=image) for image in images]))
        for number, images in enumerate(tracks)
    }
    return SimpleNamespace(reg_image_ids=lambda: [1, 2, 3, 4, 5, 6], points3D=points)


def test_images_hold_together_where_chains_share_enough_points_of_three_images():
    chain = (40, (1, 2, 3)), (40, (3, 4, 5)), (40, (4, 5, 6))
    assert _held_together(model_of(*chain)) == [{1, 2, 3, 4, 5, 6}]
    weak = (40, (1, 2, 3)), (20, (3, 4, 5)), (40, (4, 5, 6))
    assert _held_together(model_of(*weak)) == [{1, 2, 3}, {4, 5, 6}]
    by_two = (40, (1, 2, 3)), (90, (3, 4)), (40, (4, 5, 6))
    assert _held_together(model_of(*by_two)) == [{1, 2, 3}, {4, 5, 6}]
