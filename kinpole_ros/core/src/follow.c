/*
 * The loop from the markers of frames to derivatives, which live and replay share.
 *
 * An unusual frame ends the loop, and is taken in Python. The result of a frame is computed when it
 * is due, from the window of frames up to the newest.
 */

#include <math.h>
#include <string.h>

#include "fit.h"
#include "memory.h"
#include "numbers.h"
#include "rejection.h"

/* The poses of a window, and their derivatives. `heading` is the angle of the body, and `angle`
   that by which its hub moves: the heading plus what a tilted body turns beyond it. */
typedef struct {
    double *angle, *heading, *turn_information, *place_information, *derivatives;
    Number *position, *hub;
    long long frames[3];
} Poses;

/* A result is due this share of an interval before its frame is as old as the lag. */
static const double EARLY = 0.75;

static Number
unit_at(double angle)
{
    return cos(angle) + I * sin(angle);
}

/* Number of frames in the history with a time before `at`, ns. */
static long long
number_before(const Frames *f, long long at)
{
    const HistoryColumns *history = &f->history;
    long long low = history->first, high = history->end;
    while (low < high) {
        long long middle = (low + high) / 2;
        if (history->time[middle] < at)
            low = middle + 1;
        else
            high = middle;
    }
    return low - history->first;
}

/* Whether the next frame follows the newest without a gap. */
static int
next_goes_on(const Frames *f)
{
    const HistoryColumns *history = &f->history;
    return history->end == history->first || history->interval == 0 ||
        f->incoming.time[f->incoming.frame] - history->time[history->end - 1] <=
            f->limits.gap * history->interval;
}

/* Fits `markers` (B, n) of the next frame into the row after the newest; what is unusual. */
int
kinpole_try_frame(Frames *f, const Number *markers)
{
    int goes_on = next_goes_on(f);
    f->history.end++;
    int found = kinpole_fit_frame(f, markers, goes_on);
    f->history.end--;
    return found;
}

/* How far a body turned about the normal beyond the change of its heading, rad, between two tilts
   at the begin and the end of a rotation with constant angular velocity. The heading is the twist
   about the normal in the swing-twist decomposition. While a body is tilted, its rate is not the
   angular velocity along the normal, and the integral of the difference depends on the path: it
   does not return to zero with the pose. The result is 0 where either tilt is not known. */
static double
extra_turn(Number before, Number after, double heading)
{
    double rest = 1.0 - square_of(before), cosine = sqrt(rest > 0.0 ? rest : 0.0);
    double rest_after = 1.0 - square_of(after);
    double after_cosine = sqrt(rest_after > 0.0 ? rest_after : 0.0);
    double turn = heading - TURN * floor(heading / TURN + 0.5);
    /* The quaternion of the rotation has the parts w + i z, `along`, and |x + i y|, `across`. */
    Number ahead = cosine * after_cosine + after * conj(before);
    Number along = ahead * unit_at(0.5 * turn);
    double across = cabs(cosine * after - after_cosine * before);
    double sine = hypot(cimag(along), across);
    double half = atan2(sine, creal(along)) * (cimag(along) / sine);
    double extra = 2.0 * carg(ahead) + 2.0 * (half - carg(along));
    return isnan(extra) ? 0.0 : extra;
}

/* Adds what tilting bodies turn beyond their headings to the newest row; only poses that are
   certainly right count for the rows after it. */
static void
follow_tilts(const Frames *f, const Number *tilts)
{
    const HistoryColumns *history = &f->history;
    const BodyTracks *tracks = &f->tracks;
    for (long long b = 0; b < f->bodies.count; b++) {
        long long at = (history->end - 1) * f->bodies.count + b;
        double angle = history->angle[at];
        double turned = extra_turn(tracks->sure_tilt[b], tilts[b], angle - tracks->sure_angle[b]);
        history->extra_turn[at] = tracks->total_turn[b] + turned;
        if (!isnan(angle) && tracks->newest[b] == 0)
            tracks->total_turn[b] = history->extra_turn[at], tracks->sure_angle[b] = angle,
            tracks->sure_tilt[b] = tilts[b];
    }
}

/* Notes that a body is seen, and the gap before if it was as long as a window. */
static void
note_seen(const Frames *f, long long b, long long stamp)
{
    const BodyTracks *tracks = &f->tracks;
    long long since = tracks->seen_last[b], lasted = stamp - since;
    long long *outage = tracks->outages + OUTAGE_FIELDS * b;
    tracks->seen_last[b] = stamp;
    if (since < 0 || lasted < f->limits.window)
        return;
    outage[OUTAGE_LATEST] = since, outage[OUTAGE_LATEST + 1] = lasted;
    if (!outage[OUTAGE_TIMES]++ || lasted > outage[OUTAGE_LONGEST + 1])
        outage[OUTAGE_LONGEST] = since, outage[OUTAGE_LONGEST + 1] = lasted;
}

/* Takes the next frame, if it is usual or was corrected. */
static int
take_frame(Frames *f)
{
    HistoryColumns *history = &f->history;
    const BodyArrays *known = &f->bodies;
    NewFrames *incoming = &f->incoming;
    long long all = known->count * known->width, row = history->end, k = incoming->frame;
    const Number *points = incoming->points + k * all;
    const Number *fitted = incoming->corrected ? incoming->corrected : points;
    const double *heights = incoming->heights + k * all;
    if (incoming->hidden_is_unusual && !incoming->corrected)
        for (long long i = 0; i < all; i++)
            if (isnan(creal(points[i])))
                return UNUSUAL;
    int goes_on = next_goes_on(f);
    history->end++;
    if (kinpole_fit_frame(f, fitted, goes_on && !incoming->corrected) && !incoming->corrected) {
        history->end--;
        return UNUSUAL;
    }
    incoming->corrected = NULL;
    history->stamp[row] = incoming->stamp[k], history->time[row] = incoming->time[k];
    history->count[row] = incoming->count[k];
    history->goes_on[row] = goes_on;
    memcpy(history->markers + row * all, points, all * sizeof *points);
    memcpy(history->heights + row * all, heights, all * sizeof *heights);
    for (long long b = 0; b < known->count; b++) {
        double sum = 0.0;
        long long seen = 0;
        for (long long i = b * known->width; i < (b + 1) * known->width; i++)
            if (!isnan(creal(fitted[i])))
                sum += heights[i], seen++;
        history->height[row * known->count + b] = seen ? sum / seen : NAN;
        history->extra_turn[row * known->count + b] = 0.0;
    }
    kinpole_unwrap(f);
    kinpole_follow_paths(f);
    if (incoming->tilts)
        follow_tilts(f, incoming->tilts + k * known->count);
    for (long long b = 0; b < known->count; b++)
        if (!isnan(history->angle[row * known->count + b]))
            note_seen(f, b, history->stamp[row]);
        else
            f->tracks.held[b] += kinpole_is_held(f, b, points + b * known->width);
    for (long long i = 0; i < all; i++) {
        long long b = i / known->width, k = i % known->width;
        f->tracks.held_markers[b] += kinpole_is_marker_held(f, b, points + b * known->width, k);
    }
    incoming->frame++, incoming->until_update--;
    return DONE;
}

/* Computes the poses of the hubs in the window from `oldest` on; whether any body tilts. */
static int
fill_window(const Frames *f, long long oldest, Poses *poses)
{
    const HistoryColumns *history = &f->history;
    const BodyArrays *known = &f->bodies;
    int tilts = 0;
    for (long long i = oldest * known->count;
         f->limits.posed && i < history->end * known->count; i++)
        tilts |= history->extra_turn[i] != 0.0;
    for (long long row = oldest; row < history->end; row++)
        for (long long b = 0; b < known->count; b++) {
            long long at = row * known->count + b, to = at - oldest * known->count;
            const double *information = history->information + 2 * row * known->count + b;
            double turned = information[0] * known->scale[b];
            double placed = information[known->count] * known->scale[known->count + b];
            double growth = 0.0;
            Number hub = poses->hub[b], position = history->position[at];
            poses->heading[to] = history->angle[at];
            poses->angle[to] =
                history->angle[at] + (tilts ? history->extra_turn[at] - known->tilt_turn[b] : 0.0);
            if (hub != 0.0) {
                position += hub * unit_at(poses->angle[to]);
                /* The variance at the hub is that at the middle of the markers, plus that of the
                   angle times the squared distance. With hidden markers the fit is about another
                   middle, so the first may come out negative. */
                if (placed > 0.0) {
                    double ratio = placed / turned;
                    growth = 1.0 - square_of(known->middle[b]) * ratio;
                    growth = (growth > 0.0 ? growth : 0.0) +
                        square_of(hub - known->middle[b]) * ratio;
                }
            }
            poses->position[to] = position;
            poses->turn_information[to] = turned;
            poses->place_information[to] = growth > 0.0 ? placed / growth : placed;
        }
    return tilts;
}

/* The weighted mean of the markers used in a row, in the frame of the body. */
static Number
middle_of_used(const Frames *f, long long row, long long b)
{
    const BodyArrays *known = &f->bodies;
    Number sum = 0.0;
    double total = 0.0;
    for (long long k = 0; k < known->width; k++)
        if (f->history.used[(row * known->count + b) * known->width + k]) {
            double weight = known->weights[b * known->width + k];
            sum += weight * known->shape[b * known->width + k], total += weight;
        }
    return total > 0.0 ? sum / total : NAN;
}

/* Copies the derivatives of one instant into the results; NaN for bodies without any. */
static void
copy_derivatives(const Frames *f, const Call *call, Results *r)
{
    long long orders = call->orders, bodies = f->bodies.count, t = r->count;
    const double *from = call->results;
    double *to = r->derivatives;
    const unsigned char *reason = r->reason + t * bodies;
    for (long long k = 0; k < 2 * orders + 2 * orders * orders + 2; k++) {
        long long size = k < orders ? 2 : 1;
        for (long long i = 0; i < size * bodies; i++)
            to[t * size * bodies + i] = reason[i / size] > NOT_FULL ? NAN : from[i];
        from += size * bodies, to += r->instants * size * bodies;
    }
}

/* The numbers that `write_results` of derive.c writes of so many bodies. */
static long long
size_of_results(long long orders, long long bodies)
{
    return (3 * orders + 2 * orders * orders + 4) * bodies;
}

/* Replaces the angles by those of the headings of tilted bodies, and turns the hubs into their
   axes. */
static int
derive_headings(Call *call, Poses *poses)
{
    long long bodies = call->bodies;
    /* The published angle is the heading; the hub is turned into its axes. */
    double *angle = poses->derivatives + 2 * call->orders * bodies;
    for (long long b = 0; b < bodies; b++)
        poses->hub[b] *= isnan(angle[b]) ? 1.0 : unit_at(angle[b]);
    call->angle = poses->heading, call->next = 0;
    call->results = poses->derivatives + size_of_results(call->orders, bodies);
    int code = kinpole_derive(call);
    if (code)
        return code;
    const double *heading = call->results + 2 * call->orders * bodies;
    for (long long b = 0; b < bodies; b++) {
        poses->hub[b] *= isnan(heading[b]) ? 1.0 : conj(unit_at(heading[b]));
        angle[b] = heading[b];
    }
    call->results = poses->derivatives;
    return DONE;
}

/* Computes the result of the frame in row `now` from the window of those from `oldest` on. */
static int
compute_result(const Frames *f, Call *call, Results *r, Poses *poses, long long oldest,
               long long now)
{
    const HistoryColumns *history = &f->history;
    const BodyArrays *known = &f->bodies;
    long long bodies = known->count, newest = history->end - 1, t = r->count, deforms = 0;
    for (long long b = 0; b < bodies; b++) {
        long long to = t * bodies + b;
        int pinned = kinpole_holds_on_pin(f, oldest, b);
        r->pin[to] = pinned ? known->pin[b] : NAN + I * NAN;
        r->pin_variance[to] = pinned ? known->pin_variance[b] : NAN;
        poses->hub[b] = pinned ? 0.0 : known->hub[b];
    }
    int tilts = fill_window(f, oldest, poses);
    call->frames = history->end - oldest, call->bodies = bodies;
    poses->frames[0] = now - oldest, poses->frames[1] = 0, poses->frames[2] = newest - oldest;
    call->time = history->time + oldest, call->turns = history->turns + oldest * bodies;
    call->windows = poses->frames, call->left_out = f->tracks.newest;
    call->angle = poses->angle, call->position = (const double *)poses->position;
    call->angle_information = poses->turn_information;
    call->position_information = poses->place_information;
    call->noise = known->noise, call->results = poses->derivatives, call->next = 0;
    int code = kinpole_derive(call);
    if (code)
        return code;
    const double *of_hubs = poses->derivatives + size_of_results(call->orders, bodies) - 2 * bodies;
    for (long long b = 0; b < bodies; b++)
        if (!isnan(of_hubs[2 * b]))
            poses->hub[b] += of_hubs[2 * b] + I * of_hubs[2 * b + 1];
    if (tilts && (code = derive_headings(call, poses)))
        return code;
    for (long long b = 0; b < bodies; b++) {
        long long at = now * bodies + b, to = t * bodies + b, orders = call->orders;
        const double *information = history->information + 2 * now * bodies + b;
        int missing = kinpole_reason(f, now, b), seen = missing < NOT_SEEN;
        const double *rate = poses->derivatives + (2 * orders + 1) * bodies + b;
        const double *velocity = poses->derivatives + 2 * (bodies + b);
        int found = isfinite(*rate) && isfinite(velocity[0]) && isfinite(velocity[1]);
        r->reason[to] = missing ? missing : found ? KNOWN : NOT_FULL;
        r->size[to] = known->size[b], r->height[to] = history->height[at];
        r->reference[to] = poses->hub[b];
        r->frame_angle[to] = history->angle[at] + TURN * history->turns[at];
        r->frame_position[to] = history->position[at];
        r->noise[to] = known->noise[b];
        r->middle[to] = f->limits.posed ? known->middle[b] : middle_of_used(f, now, b);
        for (int c = 0; c < 2; c++)
            r->information[(2 * t + c) * bodies + b] =
                seen ? information[c * bodies] * known->scale[c * bodies + b] : 0.0;
        deforms |= r->reason[to] == KNOWN && known->freedom[b] > 0.0;
    }
    copy_derivatives(f, call, r);
    memcpy(r->shape + t * bodies * known->width, known->known_shape,
           bodies * known->width * sizeof *r->shape);
    r->stamp[t] = history->stamp[now], r->due[t] = f->incoming.frame - 1;
    r->rows[3 * t] = now - history->first, r->rows[3 * t + 1] = oldest - history->first;
    r->rows[3 * t + 2] = newest - history->first;
    r->count++, r->deformed += deforms;
    return DONE;
}

/* Computes the results that are due with the newest frame. */
static int
compute_due(Frames *f, Call *call, Results *r)
{
    HistoryColumns *history = &f->history;
    const BodyArrays *known = &f->bodies;
    if (history->end == history->first)
        return DONE;
    long long newest = history->end - 1, oldest;
    oldest = history->first + number_before(f, history->time[newest] - f->limits.window);
    history->samples = newest - oldest + 1;
    history->interval = (double)(history->time[newest] - history->time[oldest]) /
        (history->samples > 1 ? history->samples - 1 : 1);
    long long latest =
        history->time[newest] - (long long)rint(f->limits.lag - EARLY * history->interval);
    long long end = number_before(f, latest + 1);
    int code = DONE;
    if (history->due < end && r->instants && newest - oldest >= r->fewest - 1) {
        if (history->first + history->due < oldest)
            history->due = oldest - history->first;
        /* Twice the space for derivatives: bodies that tilt have two angles. */
        long long all = (history->end - oldest) * known->count;
        long long derivatives = 2 * size_of_results(call->orders, known->count);
        Poses poses;
        double *data = kinpole_buffer(
            call, OF_POSES, (6 * all + derivatives + 2 * known->count) * sizeof *data);
        if (!data)
            return NO_MEMORY;
        poses.position = (Number *)data, poses.hub = (Number *)(data + 2 * all);
        poses.angle = data + 2 * all + 2 * known->count, poses.heading = poses.angle + all;
        poses.turn_information = poses.heading + all;
        poses.place_information = poses.turn_information + all;
        poses.derivatives = poses.place_information + all;
        for (; !code && history->due < end; ) {
            if (r->count == r->instants) {
                code = FULL;
                break;
            }
            code = compute_result(f, call, r, &poses, oldest, history->first + history->due);
            if (code == DONE)
                history->due++;
        }
        if (code)
            return code;
    }
    history->due = end > history->due ? end : history->due;
    return DONE;
}

/* Takes frames while they are usual, and computes the results that are due. Returns DONE, or why it
   has to be called again after step.py has done its part. */
int
kinpole_follow(Frames *f, Call *call, Results *r)
{
    const NewFrames *incoming = &f->incoming;
    for (;;) {
        int code = compute_due(f, call, r);
        if (code || incoming->frame == incoming->frames || incoming->until_update <= 0)
            return code;
        code = take_frame(f);
        if (code)
            return code;
    }
}
