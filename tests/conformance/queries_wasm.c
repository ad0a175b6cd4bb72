/* The queries of c/touch_query.h for WebAssembly, for tests: queries.mjs calls them from node. */
#include "touch_query.h"

#define EXPORT(name) __attribute__((export_name(#name)))
extern unsigned char __heap_base;

static char *memory;
static double row[14]; /* N, N/m, N and Hz */

/* Room for the memory of a receiver; its address. */
EXPORT(room) char *room(double bytes) {
    size_t start = ((size_t)&__heap_base + 63) & ~(size_t)63, pages = ((size_t)bytes + start) / 65536 + 1;
    size_t own = __builtin_wasm_memory_size(0);
    if (pages > own && __builtin_wasm_memory_grow(0, pages - own) == (size_t)-1) return NULL;
    return memory = (char *)start;
}

/* Force, gradient and vibration at a point, fourteen numbers. */
EXPORT(query) const double *query(double before, double after, double blend, double x, double y, double z) {
    touch_instant t = touch_instant_of(memory, (int64_t)before, (int64_t)after, blend);
    touch_vector point = touch_vector_of(x, y, z), force = touch_force_at(&t, point);
    touch_matrix gradient = touch_gradient_at(&t, point, force);
    memcpy(row, &force, sizeof force);
    memcpy(row + 3, &gradient, sizeof gradient);
    touch_vibration_at(&t, point, row + 12, row + 13);
    return row;
}
