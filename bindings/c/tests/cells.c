// A member by cells, in C: each body is shown once and within its bound.
//
// Arguments: address and fingerprint of a server that divides its scenes into columns of ten metres.

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "rhumb.h"

enum { BALLS = 40, MOST = 256 };

// The call returns this code, and an error leaves a sentence.
#define EXPECT(code, call) expect((code), (call), #call, __LINE__)
#define HOLDS(condition) holds((condition), #condition, __LINE__)

static void expect(RhumbCode code, RhumbCode got, const char *call, int line) {
    bool said = code == RHUMB_CODE_OK || strlen(rhumb_last_error()) > 0;
    if (got != code || !said) {
        fprintf(stderr, "line %d: %s is %u instead of %u: %s\n", line, call, (unsigned)got, (unsigned)code, rhumb_last_error());
        exit(1);
    }
}

static void holds(bool condition, const char *what, int line) {
    if (!condition) {
        fprintf(stderr, "line %d: does not hold: %s\n", line, what);
        exit(1);
    }
}

static RhumbScene joined(char **server, bool cells) {
    RhumbConnectOptions how = {.address = server[1], .fingerprint = server[2]};
    RhumbConnection connection;
    RhumbScene scene;
    RhumbJoinOptions options;
    EXPECT(RHUMB_CODE_OK, rhumb_connect(&how, &connection));
    EXPECT(RHUMB_CODE_OK, rhumb_join_options_init(&options));
    HOLDS(options.cells == 0);
    options.has_gravity = 1;
    options.tolerance_m = cells ? 0.05 : 0.001;
    options.cells = cells;
    EXPECT(RHUMB_CODE_OK, rhumb_join(connection, "walk", &options, &scene));
    return scene;
}

static void furnish(RhumbScene owner) {
    RhumbBodyDesc descs[BALLS];
    RhumbBody bodies[BALLS];
    for (int i = 0; i < BALLS; i++) {
        EXPECT(RHUMB_CODE_OK, rhumb_body_desc_init(&descs[i]));
        descs[i].position[0] = 2.0F * (float)i;
        descs[i].position[1] = 5.0F;
        descs[i].position[2] = 3.0F * (float)(i % 5) - 6.0F;
        descs[i].linear_velocity[0] = (float)(i % 7) - 3.0F;
    }
    EXPECT(RHUMB_CODE_OK, rhumb_scene_add_bodies(owner, descs, BALLS, bodies));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_advance(owner, 0, NULL));
}

/* The pose of a body of the whole scene. */
static const float *position(const RhumbPoses *poses, RhumbBody body) {
    for (size_t i = 0; i < poses->count; i++) {
        if (poses->bodies[i] == body) return poses->positions + 3 * i;
    }
    fprintf(stderr, "the scene has no such body\n");
    exit(1);
}

static void compare(RhumbScene walker, RhumbScene owner, size_t *compared) {
    RhumbPoses shown, whole;
    float bounds[BALLS];
    EXPECT(RHUMB_CODE_OK, rhumb_scene_poses(walker, &shown));
    do {
        EXPECT(RHUMB_CODE_OK, rhumb_scene_idle(owner, 0.001));
        EXPECT(RHUMB_CODE_OK, rhumb_scene_poll(owner, NULL));
        EXPECT(RHUMB_CODE_OK, rhumb_scene_poses(owner, &whole));
    } while (whole.tick < shown.tick);
    HOLDS(shown.count <= BALLS);
    EXPECT(RHUMB_CODE_OK, rhumb_scene_error_bounds(walker, shown.bodies, shown.count, bounds));
    for (size_t i = 0; i < shown.count; i++) {
        const float *truth = position(&whole, shown.bodies[i]);
        const float *here = shown.positions + 3 * i;
        float error = hypotf(hypotf(here[0] - truth[0], here[1] - truth[1]), here[2] - truth[2]);
        HOLDS(error <= bounds[i] + 0.00102F && bounds[i] <= 0.20001F);
        for (size_t j = 0; j < i; j++) HOLDS(shown.bodies[i] != shown.bodies[j]);
    }
    *compared += shown.count;
}

static void walk(RhumbScene walker, RhumbScene owner) {
    const RhumbCellBand bands[2] = {{8, 0.01}, {25, 0.2}};
    size_t compared = 0, gone = 0;
    for (int step = 0; step < 200; step++) {
        const float at[3] = {0.4F * (float)step, 5, 0};
        RhumbPoses poses;
        EXPECT(RHUMB_CODE_OK, rhumb_scene_take_cells_around(walker, at, bands, 2));
        EXPECT(RHUMB_CODE_OK, rhumb_scene_advance(walker, 0, NULL));
        EXPECT(RHUMB_CODE_OK, rhumb_scene_poses(walker, &poses));
        gone += poses.removed_count;
        compare(walker, owner, &compared);
    }
    HOLDS(compared > 1500 && gone > 5);
}

static void choose(RhumbScene walker) {
    const RhumbCellChoice choices[2] = {{{0, 0, 0}, 0}, {{0, 1, 0}, 0.1}};
    RhumbTakenCell cells[MOST];
    size_t count = 0;
    EXPECT(RHUMB_CODE_OK, rhumb_scene_take_cells(walker, choices, 2));
    do {
        EXPECT(RHUMB_CODE_OK, rhumb_scene_advance(walker, 0, NULL));
        EXPECT(RHUMB_CODE_OK, rhumb_scene_cells(walker, cells, MOST, &count));
        HOLDS(count == 2);
    } while (cells[0].state == RHUMB_CELL_STATE_AWAITED || cells[1].state == RHUMB_CELL_STATE_AWAITED);
    HOLDS(cells[0].state == RHUMB_CELL_STATE_SHOWN && cells[0].text[0] == 0 && cells[0].places[1] == 0);
    HOLDS(cells[1].state == RHUMB_CELL_STATE_DENIED && cells[1].places[1] == 1);
    HOLDS(strstr(cells[1].text, "no such cell") != NULL);
    EXPECT(RHUMB_CODE_TOO_SMALL, rhumb_scene_cells(walker, cells, 1, &count));
    HOLDS(count == 2);
}

static void misuse(RhumbScene walker, RhumbScene owner) {
    const float at[3] = {0};
    const RhumbCellBand far = {500, 0.1}, negative = {-1, 0.1}, tiny = {1, 1e-9};
    const RhumbCellChoice choice = {{0, 0, 0}, 0.1};
    RhumbTakenCell cell;
    float edges[3];
    size_t count = 0;
    EXPECT(RHUMB_CODE_OK, rhumb_scene_cell_grid(walker, edges));
    HOLDS(edges[0] == 10 && edges[1] == 0 && edges[2] == 10);
    EXPECT(RHUMB_CODE_OK, rhumb_scene_cell_grid(owner, edges));
    HOLDS(edges[0] == 0 && edges[1] == 0 && edges[2] == 0);
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_cell_grid(walker, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_take_cells_around(walker, at, &far, 1));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_take_cells_around(walker, at, &negative, 1));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_take_cells_around(walker, at, &tiny, 1));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_take_cells_around(owner, at, &far, 1));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_take_cells_around(walker, NULL, &far, 1));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_take_cells_around(walker, at, NULL, 1));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_take_cells(owner, &choice, 1));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_take_cells(walker, NULL, 1));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_take_cells(walker, NULL, 0));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_cells(walker, NULL, 0, &count));
    HOLDS(count == 0);
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_cells(walker, &cell, 1, NULL));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_close(walker));
    EXPECT(RHUMB_CODE_CLOSED, rhumb_scene_cells(walker, &cell, 1, &count));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_close(owner));
}

int main(int argc, char **argv) {
    if (argc != 3) {
        fprintf(stderr, "address and fingerprint are missing\n");
        return 1;
    }
    RhumbScene owner = joined(argv, false);
    furnish(owner);
    RhumbScene walker = joined(argv, true);
    walk(walker, owner);
    choose(walker);
    misuse(walker, owner);
    printf("each body was shown once and within its bound\n");
    return 0;
}
