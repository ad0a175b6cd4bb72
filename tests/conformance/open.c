/* What `touch_open` says of files, for tests: open FILE... Prints a code a line. */
#define TOUCH_IMPLEMENTATION
#include "touch.h"

#include <stdio.h>
#include <stdlib.h>

int main(int count, char **words) {
    for (int n = 1; n < count; n++) {
        FILE *in = fopen(words[n], "rb");
        if (!in || fseek(in, 0, SEEK_END)) return 64;
        size_t size = (size_t)ftell(in);
        uint8_t *bytes = malloc(size + 1);
        rewind(in);
        if (!bytes || fread(bytes, 1, size, in) != size) return 64;
        touch_file file;
        printf("%d\n", touch_open(&file, bytes, size));
        free(bytes), fclose(in);
    }
    return 0;
}
