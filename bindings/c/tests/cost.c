// The cost of a frame of 10,000 moving bodies in C.
//
// Arguments: the server's address and fingerprint. Prints medians in microseconds.

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "rhumb.h"

enum { BODIES = 10000, FRAMES = 300 };

static void check(RhumbCode code, const char *what) {
    if (code != RHUMB_CODE_OK) {
        fprintf(stderr, "%s: %s\n", what, rhumb_last_error());
        exit(1);
    }
}

static double now_us(void) {
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec * 1e6 + (double)now.tv_nsec / 1e3;
}

static int by_size(const void *a, const void *b) {
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double median(double *times) {
    qsort(times, FRAMES, sizeof *times, by_size);
    return times[FRAMES / 2];
}

int main(int count, char **arguments) {
    if (count != 3) return 2;
    RhumbConnectOptions server = {.address = arguments[1], .fingerprint = arguments[2], .timeout_s = 60};
    RhumbConnection connection;
    RhumbScene scene;
    RhumbJoinOptions options;
    check(rhumb_connect(&server, &connection), "connect");
    check(rhumb_join_options_init(&options), "options");
    options.condition = RHUMB_JOIN_CONDITION_CREATE;
    options.has_gravity = 1;
    check(rhumb_join(connection, "cost-c", &options, &scene), "join");
    RhumbBodyDesc *descs = calloc(BODIES, sizeof *descs);
    RhumbBody *bodies = calloc(BODIES, sizeof *bodies);
    if (descs == NULL || bodies == NULL) return 1;
    for (int i = 0; i < BODIES; i++) {
        check(rhumb_body_desc_init(&descs[i]), "init");
        descs[i].shape.radius = 0.25f;
        descs[i].position[0] = (float)(i % 100) * 2;
        descs[i].position[2] = (float)(i / 100) * 2;
        descs[i].linear_velocity[1] = 1;
    }
    check(rhumb_scene_add_bodies(scene, descs, BODIES, bodies), "add");
    free(descs);
    free(bodies);
    for (int i = 0; i < 30; i++) check(rhumb_scene_advance(scene, 0, NULL), "advance");

    static double advances[FRAMES], lent[FRAMES], copied[FRAMES], calls[FRAMES];
    static float positions[3 * BODIES], rotations[4 * BODIES];
    size_t written;
    for (int i = 0; i < FRAMES; i++) {
        RhumbPoses poses;
        RhumbPoseBuffers buffers = {.capacity = BODIES, .positions = positions, .rotations = rotations};
        const double begun = now_us();
        check(rhumb_scene_advance(scene, 1, NULL), "advance");
        const double advanced = now_us();
        check(rhumb_scene_poses(scene, &poses), "poses");
        const double read = now_us();
        check(rhumb_scene_copy_poses(scene, &buffers, &written), "copy");
        const double done = now_us();
        check(rhumb_scene_flush(scene), "flush");
        advances[i] = advanced - begun;
        lent[i] = read - advanced;
        copied[i] = done - read;
        calls[i] = now_us() - done;
    }
    printf("C: advance %.1f, poses lent %.1f, positions and rotations copied %.1f, a call %.2f\n", median(advances), median(lent),
           median(copied), median(calls));
    check(rhumb_scene_delete(scene), "delete");
    check(rhumb_scene_close(scene), "close");
    return 0;
}
