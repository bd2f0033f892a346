// A server in the process, in C.
//
// Several members of it, on threads of their own, and each misuse of its handle.

#include <pthread.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "rhumb.h"

#define TICKS 100

// The call returns this code, and an error leaves a sentence.
#define EXPECT(code, call) expect((code), (call), #call, __LINE__)

static void expect(RhumbCode code, RhumbCode got, const char *call, int line) {
    bool said = code == RHUMB_CODE_OK || strlen(rhumb_last_error()) > 0;
    if (got != code || !said) {
        fprintf(stderr, "line %d: %s is %u instead of %u: %s\n", line, call, (unsigned)got, (unsigned)code, rhumb_last_error());
        exit(1);
    }
}

static RhumbScene joined(RhumbLocalServer server) {
    RhumbConnection connection;
    RhumbScene scene;
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_connect(server, 30, &connection));
    EXPECT(RHUMB_CODE_OK, rhumb_join(connection, "shared", NULL, &scene));
    return scene;
}

static void *run(void *member) {
    RhumbScene scene = *(RhumbScene *)member;
    RhumbBodyDesc desc;
    RhumbBody body;
    uint64_t tick = 0;
    EXPECT(RHUMB_CODE_OK, rhumb_body_desc_init(&desc));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_add_bodies(scene, &desc, 1, &body));
    for (int i = 0; i < TICKS; i++) {
        uint64_t before = tick;
        EXPECT(RHUMB_CODE_OK, rhumb_scene_advance(scene, 0, &tick));
        if (tick < before) exit(1);
    }
    if (tick != TICKS) exit(1);
    return NULL;
}

static void members_take_turns(uint8_t own_thread) {
    RhumbLocalServer server;
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_open(own_thread, &server));
    RhumbScene members[2] = {joined(server), joined(server)};
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_close(server));
    pthread_t threads[2];
    for (int i = 0; i < 2; i++) {
        if (pthread_create(&threads[i], NULL, run, &members[i]) != 0) exit(1);
    }
    for (int i = 0; i < 2; i++) {
        if (pthread_join(threads[i], NULL) != 0) exit(1);
        EXPECT(RHUMB_CODE_OK, rhumb_scene_close(members[i]));
    }
}

static void misuse(void) {
    RhumbLocalServer none = {0}, server;
    RhumbConnection connection;
    EXPECT(RHUMB_CODE_NULL, rhumb_local(NULL));
    EXPECT(RHUMB_CODE_NULL, rhumb_local_server_open(0, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_local_server_open(2, &server));
    EXPECT(RHUMB_CODE_CLOSED, rhumb_local_server_connect(none, 0, &connection));
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_open(0, &server));
    EXPECT(RHUMB_CODE_NULL, rhumb_local_server_connect(server, 0, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_local_server_connect(server, -1, &connection));
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_connect(server, 0, &connection));
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_close(server));
    EXPECT(RHUMB_CODE_CLOSED, rhumb_local_server_close(server));
    EXPECT(RHUMB_CODE_CLOSED, rhumb_local_server_connect(server, 0, &connection));
    EXPECT(RHUMB_CODE_OK, rhumb_connection_close(connection));
    EXPECT(RHUMB_CODE_OK, rhumb_local(&connection));
    EXPECT(RHUMB_CODE_OK, rhumb_connection_close(connection));
}

static void misuse_of_files_and_sockets(void) {
    RhumbLocalServer server;
    RhumbConnection connection;
    RhumbScene scene;
    RhumbAddress address;
    RhumbLoaded none = {0}, loaded;
    RhumbLoadedCounts counts;
    RhumbLoadOptions options;
    EXPECT(RHUMB_CODE_NULL, rhumb_serve(NULL, 0, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_serve("nowhere", 0, &server));
    EXPECT(RHUMB_CODE_INVALID, rhumb_serve(NULL, 2, &server));
    EXPECT(RHUMB_CODE_OK, rhumb_serve(NULL, 0, &server));
    EXPECT(RHUMB_CODE_NULL, rhumb_local_server_address(server, NULL));
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_address(server, &address));
    RhumbConnectOptions how = {.address = address.text};
    EXPECT(RHUMB_CODE_OK, rhumb_connect(&how, &connection));
    EXPECT(RHUMB_CODE_OK, rhumb_join(connection, "files", NULL, &scene));
    EXPECT(RHUMB_CODE_OK, rhumb_load_options_init(&options));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_load(scene, NULL, &options, &loaded));
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_load(scene, "a.urdf", &options, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_load(scene, "a.urdf", &options, &loaded));
    options.base = 3;
    EXPECT(RHUMB_CODE_INVALID, rhumb_scene_load(scene, "a.urdf", &options, &loaded));
    EXPECT(RHUMB_CODE_CLOSED, rhumb_loaded_counts(none, &counts));
    EXPECT(RHUMB_CODE_CLOSED, rhumb_loaded_close(none));
    EXPECT(RHUMB_CODE_DENIED, rhumb_scene_page(scene, &address));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_close(scene));
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_close(server));
}

static void misuse_of_checkpoints(void) {
    RhumbLocalServer server, served;
    RhumbConnection connection;
    RhumbCheckpoint none = {0}, saved, read;
    size_t count = 0;
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_open(0, &server));
    RhumbScene scene = joined(server);
    EXPECT(RHUMB_CODE_NULL, rhumb_scene_save(scene, NULL));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_save(scene, &saved));
    EXPECT(RHUMB_CODE_NULL, rhumb_checkpoint_bytes(saved, NULL, 0, NULL));
    EXPECT(RHUMB_CODE_TOO_SMALL, rhumb_checkpoint_bytes(saved, NULL, 0, &count));
    uint8_t *bytes = malloc(count);
    EXPECT(RHUMB_CODE_NULL, rhumb_checkpoint_bytes(saved, NULL, count, &count));
    EXPECT(RHUMB_CODE_OK, rhumb_checkpoint_bytes(saved, bytes, count, &count));
    EXPECT(RHUMB_CODE_NULL, rhumb_checkpoint_read(NULL, count, &read));
    EXPECT(RHUMB_CODE_NULL, rhumb_checkpoint_read(bytes, count, NULL));
    EXPECT(RHUMB_CODE_INVALID, rhumb_checkpoint_read(bytes, count - 1, &read));
    EXPECT(RHUMB_CODE_INVALID, rhumb_checkpoint_read(NULL, 0, &read));
    EXPECT(RHUMB_CODE_OK, rhumb_checkpoint_read(bytes, count, &read));
    free(bytes);
    EXPECT(RHUMB_CODE_NULL, rhumb_local_server_restore(server, NULL, read));
    EXPECT(RHUMB_CODE_INVALID, rhumb_local_server_restore(server, "a b", read));
    EXPECT(RHUMB_CODE_DENIED, rhumb_local_server_restore(server, "shared", read));
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_restore(server, "fork", read));
    EXPECT(RHUMB_CODE_CLOSED, rhumb_local_server_restore(server, "another", none));
    EXPECT(RHUMB_CODE_OK, rhumb_checkpoint_close(read));
    EXPECT(RHUMB_CODE_CLOSED, rhumb_checkpoint_close(read));
    EXPECT(RHUMB_CODE_CLOSED, rhumb_checkpoint_bytes(read, NULL, 0, &count));
    EXPECT(RHUMB_CODE_OK, rhumb_serve(NULL, 0, &served));
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_restore(served, "shared", saved));
    EXPECT(RHUMB_CODE_DENIED, rhumb_local_server_restore(served, "shared", saved));
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_connect(served, 30, &connection));
    RhumbScene elsewhere;
    EXPECT(RHUMB_CODE_OK, rhumb_join(connection, "shared", NULL, &elsewhere));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_save(elsewhere, &read));
    EXPECT(RHUMB_CODE_OK, rhumb_checkpoint_close(read));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_close(elsewhere));
    EXPECT(RHUMB_CODE_OK, rhumb_scene_close(scene));
    EXPECT(RHUMB_CODE_CLOSED, rhumb_scene_save(scene, &read));
    EXPECT(RHUMB_CODE_OK, rhumb_checkpoint_close(saved));
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_close(served));
    EXPECT(RHUMB_CODE_OK, rhumb_local_server_close(server));
}

int main(void) {
    members_take_turns(0);
    members_take_turns(1);
    misuse();
    misuse_of_files_and_sockets();
    misuse_of_checkpoints();
    printf("the members took turns\n");
    return 0;
}
