/* Bytes between the pieces of an arena that the address sanitizer watches: include it before touch.h or touch_encode.h. */
#ifndef WATCHED_ARENA_H
#define WATCHED_ARENA_H

#include <stddef.h>
#include <stdint.h>

void __asan_poison_memory_region(void const volatile *at, size_t bytes);
void __asan_unpoison_memory_region(void const volatile *at, size_t bytes);

static uint64_t watch(uint8_t *at, uint64_t bytes, uint64_t behind) {
    __asan_unpoison_memory_region(at, (size_t)bytes);
    __asan_poison_memory_region(at + bytes, (size_t)behind);
    return behind;
}

#define TOUCH_GUARD(at, bytes, behind) watch(at, bytes, behind)

#endif
