#include <stdlib.h>

#include "memory.h"

PRIVATE void *
buffer(int which, size_t size)
{
    static _Thread_local struct {
        void *data;
        size_t size;
    } all[BUFFERS];
    if (size > all[which].size) {
        free(all[which].data);
        all[which].data = malloc(size);
        all[which].size = all[which].data ? size : 0;
    }
    return all[which].data;
}
