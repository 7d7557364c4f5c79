"""The package with more or fewer extensions."""

import pytest

from atlas import extension, variables
from atlas.analysis import metadata
from atlas.systems.base import derived_variables

KEPT = extension._found, extension.parts, derived_variables, variables._registry, metadata._registered


@pytest.fixture
def forget():
    """Function that clears what this process keeps of the extensions, called once more after the test."""

    def clear():
        for each in KEPT:
            getattr(each, "cache_clear", lambda: None)()

    yield clear
    clear()


@pytest.fixture
def without(forget):
    """Function of a name: from then on the extension is not installed."""
    extensions, broken = extension._found()
    with pytest.MonkeyPatch.context() as patched:

        def hide(name):
            others = {key: each for key, each in extensions.items() if key != name}
            assert len(others) == len(extensions) - 1
            patched.setattr(extension, "_found", lambda: (others, broken))
            forget()

        yield hide
