"""The version of petmjx, which results and pages state: the version of the git tag at the time of installation."""

__all__ = ["__version__"]

try:
    from petmjx._version import __version__  # the build writes this module (pyproject.toml)
except ImportError:  # the checkout was never installed
    __version__ = "0.2.0.dev0"
