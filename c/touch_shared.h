/* touch_shared.h: numbers in memory that two threads, or two programs, share. */
#ifndef TOUCH_SHARED_H
#define TOUCH_SHARED_H

#include <stdint.h>

/* A full fence: what is written before it is seen before what is written after it. */
#if defined(__GNUC__) || defined(__clang__)
#define TOUCH_FENCE() __atomic_thread_fence(__ATOMIC_SEQ_CST)
#else
#include <windows.h>
#define TOUCH_FENCE() MemoryBarrier()
#endif

/* Numbers that another thread writes, or reads, while this one runs: what was written before a number is seen by who has
   seen the number. */
#if defined(__GNUC__) || defined(__clang__)
static inline int64_t touch_shared(const int64_t *number) { return __atomic_load_n(number, __ATOMIC_ACQUIRE); }
static inline void touch_share(int64_t *number, int64_t value) { __atomic_store_n(number, value, __ATOMIC_RELEASE); }
static inline void touch_share_double(double *number, double value) { __atomic_store(number, &value, __ATOMIC_RELEASE); }
static inline double touch_shared_double(const double *number) {
    double value;
    __atomic_load(number, &value, __ATOMIC_ACQUIRE);
    return value;
}
#else
static inline int64_t touch_shared(const int64_t *number) { return *(const volatile int64_t *)number; }
static inline void touch_share(int64_t *number, int64_t value) { *(volatile int64_t *)number = value; }
static inline void touch_share_double(double *number, double value) { *(volatile double *)number = value; }
static inline double touch_shared_double(const double *number) { return *(const volatile double *)number; }
#endif

#endif
