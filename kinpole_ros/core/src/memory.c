/*
 * Memory that the library works in: a workspace that its `Call` owns.
 */

#include <stdlib.h>

#include "memory.h"

struct Workspace {
    struct {
        void *data;
        size_t size;
    } buffer[BUFFERS];
};

void *
kinpole_buffer(Call *call, int which, size_t size)
{
    if (!call->workspace)
        call->workspace = calloc(1, sizeof *call->workspace);
    Workspace *workspace = call->workspace;
    if (workspace && size > workspace->buffer[which].size) {
        free(workspace->buffer[which].data);
        workspace->buffer[which].data = calloc(1, size);
        workspace->buffer[which].size = workspace->buffer[which].data ? size : 0;
    }
    return workspace ? workspace->buffer[which].data : NULL;
}

void
kinpole_free_workspace(Call *call)
{
    for (int k = 0; call->workspace && k < BUFFERS; k++)
        free(call->workspace->buffer[k].data);
    free(call->workspace);
    call->workspace = NULL;
}
