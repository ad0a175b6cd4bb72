/* Times single queries of a field by the processor's counter, for bench_query.py, which loads this file as a library. */
#include "../c/touch_query.h"

/* The counter, read when all before it is done and before anything after it begins: neither the compiler nor the processor may
   move a query across it. */
#if defined(__x86_64__) || defined(_M_X64)
#include <x86intrin.h>
static inline int64_t counter(void) {
    __asm__ volatile("" ::: "memory");
    _mm_lfence();
    int64_t count = (int64_t)__rdtsc();
    _mm_lfence();
    __asm__ volatile("" ::: "memory");
    return count;
}
#elif defined(__aarch64__)
static inline int64_t counter(void) {
    int64_t count;
    __asm__ volatile("isb\n\tmrs %0, cntvct_el0\n\tisb" : "=r"(count)::"memory");
    return count;
}
#endif

__attribute__((visibility("default"))) int64_t count_now(void);
int64_t count_now(void) { return counter(); }

/* Counts of each query of points double [n][3], and of an empty interval, into counts [n][2]; the forces, double [n][3]. */
__attribute__((visibility("default"))) void time_queries(const void *memory, int64_t before, int64_t after, double blend,
                                                         const double *point_m, int64_t n, int64_t *counts, double *force_n);
void time_queries(const void *memory, int64_t before, int64_t after, double blend, const double *point_m, int64_t n,
                  int64_t *counts, double *force_n) {
    for (int64_t p = 0; p < n; p++) {
        touch_vector point = touch_vector_of(point_m[3 * p], point_m[3 * p + 1], point_m[3 * p + 2]);
        int64_t start = counter();
        touch_instant t = touch_instant_of(memory, before, after, blend);
        touch_vector force = touch_force_at(&t, point);
        force_n[3 * p] = force.x, force_n[3 * p + 1] = force.y, force_n[3 * p + 2] = force.z;
        int64_t middle = counter(), end = counter();
        counts[2 * p] = middle - start, counts[2 * p + 1] = end - middle;
    }
}
