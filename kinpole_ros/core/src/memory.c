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

int
kinpole_lay_out_derivatives(Call *call, int which, long long poses, DerivativeArrays *d)
{
    long long orders = call->orders, square = orders * orders;
    size_t of_pose = (orders + 1) * sizeof(Number) + (orders + 2 * square + 2) * sizeof(double);
    char *data = kinpole_buffer(call, which, poses * of_pose);
    if (!data)
        return NO_MEMORY;
    TAKE(d->position, orders * poses), TAKE(d->reference, poses), TAKE(d->angle, orders * poses);
    TAKE(d->position_covariance, square * poses), TAKE(d->angle_covariance, square * poses);
    TAKE(d->span, poses), TAKE(d->parameters, poses);
    return DONE;
}

void
kinpole_free_workspace(Call *call)
{
    for (int k = 0; call->workspace && k < BUFFERS; k++)
        free(call->workspace->buffer[k].data);
    free(call->workspace);
    call->workspace = NULL;
}
