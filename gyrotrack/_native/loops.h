/* What the inner loops share: arrays from Python, and medians. */
#ifndef GYROTRACK_LOOPS_H
#define GYROTRACK_LOOPS_H
#define PY_SSIZE_T_CLEAN
#define Py_LIMITED_API 0x030B0000
#include <Python.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

/* Arrays that are in use; all are given back together. */
typedef struct {
    Py_buffer *view;
    Py_ssize_t count;
} Arrays;

void give_back(Arrays *arrays);
Py_buffer *take(Arrays *arrays, PyObject **given, const char *kinds);
PyObject *misfit(void);

double ranked(double *values, Py_ssize_t count, Py_ssize_t rank);

PyObject *loops_cut(PyObject *self, PyObject *args);
PyObject *loops_find(PyObject *self, PyObject *args);
PyObject *loops_bands(PyObject *self, PyObject *args);
PyObject *loops_crossing(PyObject *self, PyObject *args);
PyObject *loops_fit(PyObject *self, PyObject *args);
PyObject *loops_disc(PyObject *self, PyObject *args);
PyObject *loops_local(PyObject *self, PyObject *args);
PyObject *loops_unlikely(PyObject *self, PyObject *args);

#endif
