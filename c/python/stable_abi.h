/* Declares the part of CPython's stable ABI (PEP 384, version 3.11 and later) that the module `touchfield._native`
   uses.

   A binary that uses only this part runs on every CPython from 3.11 on. It is declared here, and not included
   from Python.h, because many systems ship Python without its headers, and because a cross compiler has only the
   headers of the machine it runs on. tests/packaging compares these declarations with Python.h where it is
   installed. All names and layouts: https://docs.python.org/3/c-api/stable.html */
#ifndef TOUCHFIELD_STABLE_ABI_H
#define TOUCHFIELD_STABLE_ABI_H

#include <stddef.h>

#ifdef _WIN32
#define PYTHON_IMPORT __declspec(dllimport)
#define PYTHON_EXPORT __declspec(dllexport)
#else
#define PYTHON_IMPORT
#define PYTHON_EXPORT __attribute__((visibility("default")))
#endif

typedef ptrdiff_t Py_ssize_t;
typedef struct _object PyObject;
typedef struct _typeobject PyTypeObject;
typedef struct _ts PyThreadState;

struct _object { /* a static PyModuleDef starts with one; nothing else is read */
    Py_ssize_t ob_refcnt;
    PyTypeObject *ob_type;
};

typedef PyObject *(*PyCFunction)(PyObject *, PyObject *);

typedef struct {
    const char *ml_name;
    PyCFunction ml_meth;
    int ml_flags;
    const char *ml_doc;
} PyMethodDef;

typedef struct {
    void *buf;
    PyObject *obj;
    Py_ssize_t len, itemsize;
    int readonly, ndim;
    char *format;
    Py_ssize_t *shape, *strides, *suboffsets;
    void *internal;
} Py_buffer;

#define PyBUF_SIMPLE 0
#define PyBUF_WRITABLE 0x0001

#define METH_VARARGS 0x0001
#define METH_NOARGS 0x0004
#define METH_O 0x0008
#define METH_FASTCALL 0x0080

typedef struct {
    PyObject ob_base;
    PyObject *(*m_init)(void);
    Py_ssize_t m_index;
    PyObject *m_copy;
} PyModuleDef_Base;

typedef struct {
    PyModuleDef_Base m_base;
    const char *m_name;
    const char *m_doc;
    Py_ssize_t m_size;
    PyMethodDef *m_methods;
    void *m_slots;
    void *m_traverse;
    void *m_clear;
    void *m_free;
} PyModuleDef;

/* clang-format off */
#define PyModuleDef_HEAD_INIT {{1, NULL}, NULL, 0, NULL}
/* clang-format on */

#define PYTHON_API_VERSION 1013

PYTHON_IMPORT PyObject *PyModule_Create2(PyModuleDef *definition, int api_version);
PYTHON_IMPORT int PyArg_ParseTuple(PyObject *arguments, const char *format, ...);
PYTHON_IMPORT PyObject *Py_BuildValue(const char *format, ...);
PYTHON_IMPORT PyObject *PyBytes_FromStringAndSize(const char *data, Py_ssize_t size);
PYTHON_IMPORT char *PyBytes_AsString(PyObject *bytes);
PYTHON_IMPORT int PyBytes_AsStringAndSize(PyObject *bytes, char **data, Py_ssize_t *size);
PYTHON_IMPORT int PyObject_GetBuffer(PyObject *object, Py_buffer *view, int flags);
PYTHON_IMPORT void PyBuffer_Release(Py_buffer *view);
PYTHON_IMPORT PyObject *PyObject_CallFunction(PyObject *callable, const char *format, ...);
PYTHON_IMPORT PyObject *PyObject_GetIter(PyObject *object);
PYTHON_IMPORT PyObject *PyIter_Next(PyObject *iterator);
PYTHON_IMPORT PyObject *PySequence_List(PyObject *sequence);
PYTHON_IMPORT Py_ssize_t PySequence_Size(PyObject *sequence);
PYTHON_IMPORT PyObject *PySequence_GetItem(PyObject *sequence, Py_ssize_t index);
PYTHON_IMPORT PyObject *PyList_New(Py_ssize_t size);
PYTHON_IMPORT int PyList_SetItem(PyObject *list, Py_ssize_t index, PyObject *item);
PYTHON_IMPORT PyObject *PyLong_FromUnsignedLongLong(unsigned long long number);
PYTHON_IMPORT PyObject *PyLong_FromLongLong(long long number);
PYTHON_IMPORT long long PyLong_AsLongLong(PyObject *number);
PYTHON_IMPORT PyObject *PyTuple_New(Py_ssize_t size);
PYTHON_IMPORT int PyTuple_SetItem(PyObject *tuple, Py_ssize_t index, PyObject *item);
PYTHON_IMPORT PyObject *PyBool_FromLong(long value);
PYTHON_IMPORT double PyFloat_AsDouble(PyObject *number);
PYTHON_IMPORT PyObject *PyFloat_FromDouble(double number);
PYTHON_IMPORT PyObject *PyCapsule_New(void *pointer, const char *name, void (*destructor)(PyObject *));
PYTHON_IMPORT void *PyCapsule_GetPointer(PyObject *capsule, const char *name);
PYTHON_IMPORT void PyErr_SetString(PyObject *type, const char *message);
PYTHON_IMPORT void PyErr_SetObject(PyObject *type, PyObject *value);
PYTHON_IMPORT PyObject *PyErr_Occurred(void);
PYTHON_IMPORT PyObject *PyErr_NoMemory(void);
PYTHON_IMPORT void Py_IncRef(PyObject *object);
PYTHON_IMPORT void Py_DecRef(PyObject *object);
PYTHON_IMPORT PyThreadState *PyEval_SaveThread(void);
PYTHON_IMPORT void PyEval_RestoreThread(PyThreadState *state);
PYTHON_IMPORT extern PyObject *PyExc_ValueError;
PYTHON_IMPORT extern PyObject _Py_NoneStruct;

#endif
