// Feeds a scene by an engine of its own, and prints what a follower gets.
//
//     feed [BALLS [SECONDS]]
//
// The engine is some lines of C: balls that fall on the ground and bounce. Once a second the follower pushes a ball, which comes
// to the engine as a request. Naive are 52 bytes for each ball that moves and each tick.

#ifndef _POSIX_C_SOURCE
#define _POSIX_C_SOURCE 200809L
#endif

#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "rhumb.h"

#define RATE 60
#define RADIUS 0.1f
#define TOLERANCE 0.05
// Of a float at 100 m, in three coordinates.
#define ROUNDING 1e-5

static int failed(const char *what) {
    fprintf(stderr, "%s: %s\n", what, rhumb_last_error());
    return 1;
}

static double evenly(double from, double to) {
    static uint64_t state = 7;
    state = state * 6364136223846793005u + 1442695040888963407u;
    return from + (to - from) * (double)(state >> 11) / 9007199254740992.0;
}

static double milliseconds(void) {
    struct timespec spent;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &spent);
    return 1e3 * (double)spent.tv_sec + 1e-6 * (double)spent.tv_nsec;
}

// One step of Euler's method. Returns the number of balls that moved.
static size_t step(float *at, float *speed, size_t count) {
    size_t moved = 0;
    for (size_t i = 0; i < count; i++) {
        float *p = at + 3 * i, *v = speed + 3 * i, before[3] = {p[0], p[1], p[2]};
        v[1] -= 9.81f / RATE;
        for (int axis = 0; axis < 3; axis++) p[axis] += v[axis] / RATE;
        if (p[1] < RADIUS) {
            p[1] = RADIUS;
            v[0] = v[2] = 0;
            v[1] = -0.5f * v[1] < 0.3f ? 0 : -0.5f * v[1];
        }
        moved += p[0] != before[0] || p[1] != before[1] || p[2] != before[2];
    }
    return moved;
}

// Requests of followers: a push changes a speed, and all else is refused.
static int answer(RhumbScene owner, const RhumbBody *bodies, float *speed, size_t count) {
    RhumbRequest request;
    for (;;) {
        if (rhumb_scene_poll_request(owner, &request) != RHUMB_CODE_OK) return failed("request");
        if (request.kind == RHUMB_REQUEST_KIND_NONE) return 0;
        if (request.kind != RHUMB_REQUEST_KIND_APPLY_IMPULSE) {
            if (rhumb_scene_refuse_request(owner, request.request) != RHUMB_CODE_OK) return failed("refuse");
            continue;
        }
        for (size_t i = 0; i < count; i++) {
            // Balls of 1 kg.
            for (int axis = 0; axis < 3 && bodies[i] == request.body; axis++) speed[3 * i + axis] += request.vector[axis];
        }
    }
}

static double greatest_error(RhumbScene follower, const RhumbBody *bodies, const float *at, size_t count, size_t *beyond) {
    RhumbPoses poses;
    double worst = 0;
    if (rhumb_scene_poses(follower, &poses) != RHUMB_CODE_OK) return INFINITY;
    for (size_t i = 0; i < count; i++) {
        size_t place;
        if (rhumb_scene_place(follower, bodies[i], &place) != RHUMB_CODE_OK) return INFINITY;
        double square = 0;
        for (int axis = 0; axis < 3; axis++) square += pow((double)poses.positions[3 * place + axis] - at[3 * i + axis], 2);
        *beyond += sqrt(square) > TOLERANCE + ROUNDING;
        worst = fmax(worst, sqrt(square));
    }
    return worst;
}

static RhumbScene joined(RhumbConnection connection) {
    RhumbJoinOptions options;
    RhumbScene scene = {0};
    rhumb_join_options_init(&options);
    options.substeps = 1;
    options.tolerance_m = TOLERANCE;
    if (rhumb_join(connection, "balls", &options, &scene) != RHUMB_CODE_OK) exit(failed("join"));
    return scene;
}

static int by_size(const void *one, const void *other) {
    double a = *(const double *)one, b = *(const double *)other;
    return (a > b) - (a < b);
}

int main(int arguments, char **words) {
    size_t count = arguments > 1 ? strtoul(words[1], NULL, 10) : 1000;
    size_t ticks = RATE * (arguments > 2 ? strtoul(words[2], NULL, 10) : 10);
    if (count == 0 || ticks == 0 || arguments > 3) return fprintf(stderr, "feed [BALLS [SECONDS]]\n"), 1;

    RhumbLocalServer server;
    RhumbConnection connection;
    if (rhumb_local_server_open(1, &server) != RHUMB_CODE_OK) return failed("server");
    if (rhumb_local_server_feed(server, "balls", 0, &connection) != RHUMB_CODE_OK) return failed("feed");
    RhumbScene owner = joined(connection);

    RhumbBodyDesc *descs = calloc(count, sizeof *descs);
    RhumbBody *bodies = calloc(count, sizeof *bodies);
    float *at = calloc(3 * count, sizeof *at), *speed = calloc(3 * count, sizeof *speed);
    double *calls = calloc(ticks, sizeof *calls);
    if (!descs || !bodies || !at || !speed || !calls) return fprintf(stderr, "no memory\n"), 1;
    for (size_t i = 0; i < count; i++) {
        rhumb_body_desc_init(&descs[i]);
        descs[i].shape.radius = RADIUS;
        descs[i].has_mass = 1;
        descs[i].mass = 1;
        for (int axis = 0; axis < 3; axis++) {
            at[3 * i + axis] = (float)(axis == 1 ? evenly(2, 22) : evenly(-100, 100));
            descs[i].position[axis] = at[3 * i + axis];
        }
    }
    if (rhumb_scene_add_bodies(owner, descs, count, bodies) != RHUMB_CODE_OK) return failed("add");
    RhumbFedStates states = {.count = count, .bodies = bodies, .positions = at, .linear_velocities = speed};
    if (rhumb_scene_feed(owner, &states, NULL) != RHUMB_CODE_OK) return failed("first states");

    // The follower joins a scene that is running.
    if (rhumb_local_server_connect(server, 0, &connection) != RHUMB_CODE_OK) return failed("connect");
    RhumbScene follower = joined(connection);
    RhumbStatistics begun, ended;
    size_t beyond = 0, moved = 0;
    double worst = 0;
    rhumb_scene_statistics(follower, &begun);
    for (size_t i = 0; i < ticks; i++) {
        uint64_t tick;
        if (answer(owner, bodies, speed, count) != 0) return 1;
        moved += step(at, speed, count);
        double start = milliseconds();
        if (rhumb_scene_feed(owner, &states, &tick) != RHUMB_CODE_OK) return failed("feed");
        calls[i] = milliseconds() - start;
        RhumbTime shown = {0};
        while (shown.tick < tick) {
            if (rhumb_scene_idle(follower, 0.0005) != RHUMB_CODE_OK) return failed("idle");
            if (rhumb_scene_poll(follower, &shown) != RHUMB_CODE_OK) return failed("poll");
        }
        worst = fmax(worst, greatest_error(follower, bodies, at, count, &beyond));
        if (i % RATE == 0) {
            RhumbCommand push = {.kind = RHUMB_COMMAND_KIND_IMPULSE, .body = bodies[i % count], .vector = {1, 5, 0}};
            if (rhumb_scene_command(follower, &push, 1, NULL) != RHUMB_CODE_OK) return failed("push");
            if (rhumb_scene_flush(follower) != RHUMB_CODE_OK) return failed("flush");
        }
    }
    rhumb_scene_statistics(follower, &ended);
    double seconds = (double)ticks / RATE;
    qsort(calls, ticks, sizeof *calls, by_size);
    printf("bodies                        %zu\n", count);
    printf("follower, kB/s                %.1f\n", (double)(ended.received_bytes - begun.received_bytes) / seconds / 1e3);
    printf("naive, kB/s                   %.1f\n", 52.0 * (double)moved / seconds / 1e3);
    printf("updates/s                     %.0f\n", (double)(ended.updates - begun.updates) / seconds);
    printf("greatest error, mm            %.1f of %.0f\n", 1e3 * worst, 1e3 * TOLERANCE);
    printf("body-ticks beyond             %zu\n", beyond);
    printf("feed, ms of its thread        %.2f in the median, %.2f at most\n", calls[ticks / 2], calls[ticks - 1]);
    rhumb_scene_close(follower);
    rhumb_scene_close(owner);
    rhumb_local_server_close(server);
    free(descs), free(bodies), free(at), free(speed), free(calls);
    return 0;
}
