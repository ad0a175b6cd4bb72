"""The paper's tables and figures, each a small script over the library: `python -m reproduction`."""
