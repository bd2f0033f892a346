// Drops a ball on a floor, and prints its position and its error bound.
//
// Without arguments, the physics is in this process. With the address and the fingerprint that `rhumb-server --open` prints,
// it is on that server.

#include <stdio.h>

#include "rhumb.h"

static int failed(const char *what) {
    fprintf(stderr, "%s: %s\n", what, rhumb_last_error());
    return 1;
}

int main(int count, char **arguments) {
    RhumbConnection connection;
    RhumbScene scene;
    if (count == 1) {
        if (rhumb_local(&connection) != RHUMB_CODE_OK) return failed("local");
    } else if (count == 3) {
        RhumbConnectOptions server = {.address = arguments[1], .fingerprint = arguments[2]};
        if (rhumb_connect(&server, &connection) != RHUMB_CODE_OK) return failed("connect");
    } else {
        fprintf(stderr, "the server's host:port and its fingerprint, or neither\n");
        return 1;
    }
    if (rhumb_join(connection, "drop", NULL, &scene) != RHUMB_CODE_OK) return failed("join");

    RhumbBodyDesc descs[2];
    RhumbBody bodies[2];
    rhumb_body_desc_init(&descs[0]);
    descs[0].kind = RHUMB_BODY_KIND_FIXED;
    descs[0].shape.kind = RHUMB_SHAPE_KIND_CUBOID;
    descs[0].shape.half_extents[0] = 10;
    descs[0].shape.half_extents[2] = 10;
    descs[0].position[1] = -0.5f;
    rhumb_body_desc_init(&descs[1]);
    descs[1].position[1] = 10;
    if (rhumb_scene_add_bodies(scene, descs, 2, bodies) != RHUMB_CODE_OK) return failed("add");

    for (int i = 0; i < 180; i++) {
        uint64_t tick;
        size_t place;
        RhumbPoses poses;
        float bound;
        if (rhumb_scene_advance(scene, 0, &tick) != RHUMB_CODE_OK) return failed("advance");
        if (rhumb_scene_poses(scene, &poses) != RHUMB_CODE_OK) return failed("poses");
        if (rhumb_scene_place(scene, bodies[1], &place) != RHUMB_CODE_OK) return failed("place");
        if (rhumb_scene_error_bounds(scene, &bodies[1], 1, &bound) != RHUMB_CODE_OK) return failed("bound");
        const float *at = poses.positions + 3 * place;
        printf("tick %llu: %.3f %.3f %.3f, within %.3f m\n", (unsigned long long)tick, at[0], at[1], at[2], bound);
    }
    if (rhumb_scene_delete(scene) != RHUMB_CODE_OK) return failed("delete");
    return rhumb_scene_close(scene) == RHUMB_CODE_OK ? 0 : failed("close");
}
