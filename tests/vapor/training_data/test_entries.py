import pytest

from vapor.benchmark.regressors.training_runs import identity
from vapor.training_data.entries import name_entries


@pytest.mark.parametrize("split", ["TrainSplit.txt", "transforms_train.json"])
def test_lists_of_splits_are_named_with_their_folder_as_they_are_all_named_alike(split):
    assert [*name_entries([f"a/{split}", f"b/{split}@3:5"])] == [f"a/{split}", f"b/{split}@3:5"]


@pytest.mark.parametrize("split", ["TrainSplit.txt", "transforms_train.json"])
def test_a_list_is_another_one_when_an_image_beside_it_changes(split, tmp_path):
    (tmp_path / split).write_text("")
    image = tmp_path / "image.png"
    image.write_bytes(b"one")
    before = identity(str(tmp_path / split))
    assert identity(str(tmp_path / split)) == before
    image.write_bytes(b"another")
    assert identity(str(tmp_path / split)) != before
