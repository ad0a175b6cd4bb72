"""The command line `touchfield`: one module for each group of commands. They parse options, call the
functions of the package and print the results."""
