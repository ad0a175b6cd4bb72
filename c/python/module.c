/* Defines the Python module `touchfield._native`: coder `touch` in C. src/touchfield/_native.pyi describes its
   functions.

   Arguments and results are buffers and bytes. Errors are a ValueError(code, text), with a code of touch.h. Other Python
   threads run while C works. The module uses CPython's stable ABI only, so that one binary serves every version from 3.11
   on. Each header ends with the list of its functions. */
#include "arguments.h"
#include "error_bound.h"
#include "fields.h"
#include "filters.h"
#include "hand.h"
#include "paper.h"
#include "parts.h"
#include "query.h"
#include "receiver.h"
#include "segments.h"
#include "settings.h"
#include "shapes.h"

static PyMethodDef methods[] = {
    SEGMENTS_METHODS,
    PARTS_METHODS,
    QUERY_METHODS,
    FIELDS_METHODS,
    FILTERS_METHODS,
    PAPER_METHODS,
    SHAPES_METHODS,
    ERROR_BOUND_METHODS,
    RECEIVER_METHODS,
    SETTINGS_METHODS,
    HAND_METHODS,
    {NULL, NULL, 0, NULL},
};

static PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_native", "Coder touch in C.", -1, methods, NULL, NULL, NULL, NULL,
};

PYTHON_EXPORT PyObject *PyInit__native(void);
PYTHON_EXPORT PyObject *PyInit__native(void) { return PyModule_Create2(&definition, 1013); }
