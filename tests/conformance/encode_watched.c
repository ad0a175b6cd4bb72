/* The encoder as a library for the address sanitizer: pieces of an arena have bytes between them that nobody may touch.
   cc -g -Og -fsanitize=address,undefined -fno-sanitize-recover=all -shared -fPIC encode_watched.c */
#include "watched_arena.h"

#define TOUCH_ENCODE_IMPLEMENTATION
#include "touch_encode.h"
