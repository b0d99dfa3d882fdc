"""`python -m diffeed`: the command `diffeed` with this very Python."""

from diffeed.cli import main

if __name__ == "__main__":
    main(prog_name="python -m diffeed")
