"""``python -m sdp_vs_penalty``: the command line."""

from sdp_vs_penalty.cli.main import main

if __name__ == "__main__":
    main()
