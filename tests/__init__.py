import pytest

pytest.register_assert_rewrite("tests.helpers")  # so that their asserts say what was found, too
