"""Lists the files that a process has loaded, when the process exits. `provenance` finds by it what code a
result depends on.

Python imports this module at its start where `provenance.Trace` is on.
"""

import atexit
import os
import sys


def _note_loaded_files() -> None:
    folder = os.environ.get("TOUCHFIELD_BENCH_TRACE", "")
    if os.path.isdir(folder):
        files = {str(getattr(module, "__file__", None) or "") for module in list(sys.modules.values())}
        with open(os.path.join(folder, f"{os.getpid()}.txt"), "a", encoding="utf-8") as out:
            out.write("\n".join([*sorted(files), ""]))


atexit.register(_note_loaded_files)
