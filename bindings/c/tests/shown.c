// Random calls of a scene, and the poses that it shows.
//
// Arguments: address, fingerprint, scene, seed, calls, stepping, extent. Each line: tick, fraction, body, position, rotation, bound.
// The same in Python, C# and JavaScript; the tests of the workspace compare the lines with the server's truth.

#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "rhumb.h"

enum { MOST = 12 };

static uint64_t state;
static RhumbBody bodies[MOST];
static size_t count;

static void check(RhumbCode code) {
    if (code != RHUMB_CODE_OK) {
        fprintf(stderr, "%s\n", rhumb_last_error());
        exit(1);
    }
}

/* The generator of all languages: Knuth's, its upper 31 bits. */
static uint64_t choose(uint64_t options) {
    state = state * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return (state >> 33) % options;
}

static float real(float least, float most) { return least + (most - least) * (float)choose(1000000) / 1e6F; }

static void show(RhumbScene scene) {
    RhumbPoses poses;
    check(rhumb_scene_poses(scene, &poses));
    float* bounds = calloc(poses.count + 1, sizeof(float));
    check(rhumb_scene_error_bounds(scene, poses.bodies, poses.count, bounds));
    for (size_t i = 0; i < poses.count; i++) {
        const float* p = poses.positions + 3 * i;
        const float* q = poses.rotations + 4 * i;
        printf("%" PRIu64 " %.9g %" PRIu64 " %.9g %.9g %.9g %.9g %.9g %.9g %.9g %.9g\n", poses.tick, poses.fraction,
               poses.bodies[i], (double)p[0], (double)p[1], (double)p[2], (double)q[0], (double)q[1], (double)q[2],
               (double)q[3], (double)bounds[i]);
    }
    free(bounds);
}

static void add(RhumbScene scene) {
    RhumbBodyDesc desc;
    check(rhumb_body_desc_init(&desc));
    desc.shape.kind = choose(2) ? RHUMB_SHAPE_KIND_BALL : RHUMB_SHAPE_KIND_CUBOID;
    desc.position[0] = real(-4, 4);
    desc.position[1] = real(1, 8);
    desc.position[2] = real(-4, 4);
    desc.kind = choose(5) == 0 ? RHUMB_BODY_KIND_KINEMATIC : RHUMB_BODY_KIND_DYNAMIC;
    check(rhumb_scene_add_bodies(scene, &desc, 1, &bodies[count]));
    count++;
}

static void call(RhumbScene scene) {
    uint64_t choice = choose(8);
    if (count == 0 || (choice == 0 && count < MOST)) {
        add(scene);
        return;
    }
    size_t place = (size_t)choose(count);
    float vector[3] = {real(-6, 6), 0, 0};
    vector[1] = real(0, 6);
    vector[2] = real(-6, 6);
    RhumbCommand command = {0};
    command.rotation[3] = 1;
    if (choice == 1 && count > 4) {
        command.kind = RHUMB_COMMAND_KIND_REMOVE_BODY;
        command.body = bodies[place];
        check(rhumb_scene_command(scene, &command, 1, NULL));
        memmove(&bodies[place], &bodies[place + 1], (count - place - 1) * sizeof(RhumbBody));
        count--;
    } else if (choice == 2 || choice == 3) {
        command.kind = choice == 2 ? RHUMB_COMMAND_KIND_SET_POSE : RHUMB_COMMAND_KIND_SET_VELOCITY;
        command.body = bodies[place];
        memcpy(command.vector, vector, sizeof vector);
        if (choice == 2) {
            command.vector[1] += 1;
        } else {
            command.angular[1] = vector[0];
        }
        check(rhumb_scene_command(scene, &command, 1, NULL));
    } else if (choice == 4) {
        check(rhumb_scene_flush(scene));
    } else if (choice == 5) {
        check(rhumb_scene_idle(scene, (double)choose(20) * 0.001));
    }
}

static void take_cells(RhumbScene scene) {
    float at[3] = {0};
    at[0] = real(-6, 6);
    at[2] = real(-6, 6);
    RhumbCellBand bands[3] = {{1, 0}, {3, 0.01}, {0, 0.2}};
    bands[2].radius = (float)choose(8);
    check(rhumb_scene_take_cells_around(scene, at, bands, 3));
}

static void step(RhumbScene scene, int free_running) {
    if (free_running) {
        check(rhumb_scene_idle(scene, (double)choose(12) * 0.001));
        check(rhumb_scene_poll(scene, NULL));
    } else if (choose(4) == 0) {
        check(rhumb_scene_poll(scene, NULL));
    } else {
        check(rhumb_scene_advance(scene, (uint32_t)choose(2), NULL));
    }
}

int main(int argc, char** argv) {
    if (argc != 8) {
        fprintf(stderr, "address, fingerprint, scene, seed, calls, stepping and extent are missing\n");
        return 1;
    }
    state = strtoull(argv[4], NULL, 10);
    int free_running = strcmp(argv[6], "free running") == 0;
    int cells = strcmp(argv[7], "cells") == 0;
    RhumbConnectOptions connect = {0};
    connect.address = argv[1];
    connect.fingerprint = argv[2];
    RhumbConnection connection;
    check(rhumb_connect(&connect, &connection));
    RhumbJoinOptions options;
    check(rhumb_join_options_init(&options));
    options.stepping = free_running ? RHUMB_STEPPING_FREE_RUNNING : RHUMB_STEPPING_LOCKSTEP;
    options.delay_ticks = (double)choose(4) * 3.0;
    options.smooth = choose(2) == 1;
    options.whole_ticks = choose(2) == 1;
    options.cells = cells != 0;
    RhumbScene scene;
    check(rhumb_join(connection, argv[3], &options, &scene));
    RhumbBodyDesc floor;
    check(rhumb_body_desc_init(&floor));
    floor.kind = RHUMB_BODY_KIND_FIXED;
    floor.shape.kind = RHUMB_SHAPE_KIND_CUBOID;
    floor.shape.half_extents[0] = floor.shape.half_extents[2] = 20;
    floor.position[1] = -0.5F;
    RhumbBody body;
    check(rhumb_scene_add_bodies(scene, &floor, 1, &body));
    for (long left = strtol(argv[5], NULL, 10); left > 0; left--) {
        call(scene);
        if (cells && choose(8) == 0) {
            take_cells(scene);
        }
        step(scene, free_running);
        show(scene);
    }
    check(rhumb_scene_idle(scene, 0.1));
    check(rhumb_scene_close(scene));
    return 0;
}
