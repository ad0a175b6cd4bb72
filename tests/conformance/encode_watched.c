/* The encoder as a library for the address sanitizer: pieces of an arena have bytes between them that nobody may touch.
   cc -g -Og -fsanitize=address,undefined -fno-sanitize-recover=all -shared -fPIC encode_watched.c */
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
#define TOUCH_ENCODE_IMPLEMENTATION
#include "touch_encode.h"
