"""The version of touchfield. The build, the command line and the files that it writes take it from here."""

__version__ = "0.1.0"
