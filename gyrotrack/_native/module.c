/* The inner loops of tracking; the modules in Python that use them say what they do.
 *
 * Each has a twin in Python, which is used where these files could not be compiled; tests hold the two together.
 * Only the stable interface of Python 3.11 is used, so that one build serves all later versions.
 */
#include "loops.h"

void give_back(Arrays *arrays)
{
    while (arrays->count > 0)
        PyBuffer_Release(&arrays->view[--arrays->count]);
}

/* Take arrays as `kinds` says, two letters each: dimensions; b, i, d for 1, 4, 8 bytes a number, capital where they
 * are written to. All are dense, but where the first dimension is in steps ("s" before). */
Py_buffer *take(Arrays *arrays, PyObject **given, const char *kinds)
{
    Py_ssize_t first = arrays->count;
    for (; *kinds; kinds += 2, given++) {
        int stepped = *kinds == 's';
        kinds += stepped;
        int ndim = kinds[0] - '0', writable = kinds[1] < 'a', letter = kinds[1] | 32;
        Py_ssize_t itemsize = letter == 'b' ? 1 : letter == 'i' ? 4 : 8;
        Py_buffer *view = &arrays->view[arrays->count];
        if (PyObject_GetBuffer(*given, view, (stepped ? PyBUF_STRIDES : PyBUF_ND) | (writable ? PyBUF_WRITABLE : 0)) < 0)
            return NULL;
        arrays->count++;
        int fits = view->ndim == ndim && view->itemsize == itemsize;
        for (Py_ssize_t dense = itemsize, k = ndim - 1; fits && stepped && k > 0; dense *= view->shape[k--])
            fits = view->strides[k] == dense;
        if (!fits) {
            PyErr_SetString(PyExc_ValueError, "an array has another shape or type than is expected");
            return NULL;
        }
    }
    return arrays->view + first;
}

PyObject *misfit(void)
{
    PyErr_SetString(PyExc_ValueError, "arrays do not fit each other");
    return NULL;
}

static PyMethodDef methods[] = {
    {"cut", loops_cut, METH_VARARGS, "Sample windows of a polar grid."},
    {"find", loops_find, METH_VARARGS, "Find papers in windows."},
    {"fit", loops_fit, METH_VARARGS, "Fit a template to profiles."},
    {"bands", loops_bands, METH_VARARGS, "Average windows over bands of rows or columns."},
    {"crossing", loops_crossing, METH_VARARGS, "Find where curves fall below a level."},
    {"local", loops_local, METH_VARARGS, "Fit polynomials about the points of a series."},
    {"disc", loops_disc, METH_VARARGS, "Find discs."},
    {"unlikely", loops_unlikely, METH_VARARGS, "Weigh how unlikely residuals are."},
    {NULL, NULL, 0, NULL},
};

static int set_edition(PyObject *module)
{
    return PyModule_AddIntConstant(module, "EDITION", 5);
}

static PyModuleDef_Slot slots[] = {{Py_mod_exec, set_edition}, {0, NULL}};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "gyrotrack._native._compiled", NULL, 0, methods, slots, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit__compiled(void)
{
    return PyModuleDef_Init(&definition);
}
