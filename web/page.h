/* What the sources of the page's module share: exports, memory, the file that is open. */
#ifndef TOUCH_PAGE_H
#define TOUCH_PAGE_H
#include <stdint.h>

#define EXPORT(name) __attribute__((export_name(#name)))

extern uint64_t page_file_at, page_file_size; /* where the file lies */
extern const char *page_message;              /* why the latest call failed */

int page_reach(uint64_t end); /* memory up to a byte; 0: above the limit of the module */
#endif
