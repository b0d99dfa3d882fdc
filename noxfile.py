"""Checks beyond one environment: every supported Python, the lowest and the newest dependencies. `pip install nox uv; nox`."""

import nox

nox.options.default_venv_backend = "uv"
nox.options.sessions = ["tests", "lowest"]
QUICK = ("-m", "not slow", "-n", "2")


@nox.session(python=["3.11", "3.12", "3.13"])
def tests(session: nox.Session) -> None:
    """All but the slow tests with the newest dependencies."""
    session.install("--upgrade", "-e", ".[test]")
    session.run("pytest", *(session.posargs or QUICK))


@nox.session(python="3.11")
def lowest(session: nox.Session) -> None:
    """All but the slow tests with the oldest dependencies that pyproject.toml admits."""
    of_then = "pyparsing==3.2.0"  # newer ones warn of what the lowest matplotlib calls
    session.install("--resolution", "lowest-direct", "-e", ".[test]", of_then)
    session.run("pytest", *(session.posargs or QUICK))
