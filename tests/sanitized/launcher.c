/* Python with the core inside it, so that the whole daemon runs under a sanitizer: `launcher -m hapticd run`.
 *
 * The run-time library of a sanitizer must be there before anything else is, and RealtimeSanitizer's is a static one,
 * so it is linked with the executable. The core is linked with it, too, as the built-in module hapticd._core, which
 * Python finds before the one that lies beside the package.
 *
 * A second module, hapticd_defect, has one function, commit(): the defect that this sanitizer is there to find, a
 * misuse of the core. tests/sanitized/daemon.py has it committed in a daemon that runs, and fails where it is not
 * reported. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <pthread.h>

#include "base/hd_histogram.h"
#include "base/hd_ring.h"
#include "base/hd_triple.h"

PyMODINIT_FUNC PyInit__core(void);

#if __has_feature(thread_sanitizer)
/* Two writers where there may be one. */
static void *publish(void *triple) {
    for (int i = 0; i < 1000; i++)
        hd_triple_publish(triple);
    return NULL;
}

static int misuse(void) {
    struct hd_triple triple;
    pthread_t writer;

    hd_triple_init(&triple);
    if (pthread_create(&writer, NULL, publish, &triple) != 0)
        return 0;
    publish(&triple);
    return pthread_join(writer, NULL) == 0;
}
#elif __has_feature(address_sanitizer)
/* A ring that is told that it has more room than it was given. */
static int misuse(void) {
    const uint64_t record = 1;
    struct hd_ring ring;

    if (hd_ring_init(&ring, sizeof record, 4) != HD_OK)
        return 0;
    ring.capacity = 8;
    for (int i = 0; i < 8; i++)
        hd_ring_push(&ring, &record);
    hd_ring_destroy(&ring);
    return 1;
}
#elif __has_feature(realtime_sanitizer)
/* The servo allocates. */
HD_RT static void tick(struct hd_ring *ring) {
    HD_RT_FOREIGN_BEGIN
    ring->slots = malloc(8);
    HD_RT_FOREIGN_END
}

static int misuse(void) {
    struct hd_ring ring;

    tick(&ring);
    hd_ring_destroy(&ring);
    return 1;
}
#else
/* UndefinedBehaviorSanitizer: an edge of a bin that does not exist, shifted out of its type. */
static int misuse(void) {
    return hd_histogram_edge_ns(400) != 1;
}
#endif

static PyObject *commit(PyObject *self, PyObject *arguments) {
    (void)self;
    (void)arguments;
    return PyBool_FromLong(misuse());
}

static PyMethodDef functions[] = {
    {"commit", commit, METH_NOARGS, "Commits the defect that is to be found."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef defect = {
    .m_base = PyModuleDef_HEAD_INIT, .m_name = "hapticd_defect", .m_methods = functions};

static PyObject *make_defect(void) {
    return PyModule_Create(&defect);
}

int main(int argc, char **argv) {
    if (PyImport_AppendInittab("hapticd._core", PyInit__core) != 0 ||
        PyImport_AppendInittab("hapticd_defect", make_defect) != 0)
        return 1;
    return Py_BytesMain(argc, argv);
}
