"""The package without one of its extensions."""

import pytest

from atlas import extension, variables
from atlas.analysis import metadata
from atlas.systems.base import derived_variables


def forget():
    """Clear what is kept of the extensions."""
    for kept in (extension.parts, derived_variables, variables._registry, metadata._registered):
        kept.cache_clear()


@pytest.fixture
def without():
    """Function of a name: from then on the extension is not installed."""
    extensions, broken = extension._found()
    with pytest.MonkeyPatch.context() as patched:

        def hide(name):
            others = {key: each for key, each in extensions.items() if key != name}
            assert len(others) == len(extensions) - 1
            patched.setattr(extension, "_found", lambda: (others, broken))
            forget()

        yield hide
    forget()
