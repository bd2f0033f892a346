// Misuse of the C++ header: errors are exceptions, handles close once.
//
// Arguments: the server's address and fingerprint.

#include <atomic>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>

#include "rhumb.hpp"

namespace {

void expect(bool holds, const char* what) {
    if (!holds) {
        std::fprintf(stderr, "does not hold: %s\n", what);
        std::exit(1);
    }
}

template <typename Call>
void expect_error(RhumbCode code, const char* what, Call call) {
    try {
        call();
    } catch (const rhumb::Error& error) {
        expect(error.code() == code, (std::string(what) + ": " + error.what()).c_str());
        expect(!std::string(error.what()).empty(), what);
        return;
    }
    expect(false, what);
}

void handles(rhumb::Connection connection) {
    const std::string with_zero("handles\0more", 12);
    expect_error(RHUMB_CODE_INVALID, "a name with a zero byte", [&] { connection.join(with_zero); });
    auto scene = connection.join("handles");
    try {
        auto wrong = rhumb::BodyDesc::dynamic(rhumb::Shape::ball(0.5));
        scene.add_body(wrong.rotation({NAN, 0, 0, 1}));
        expect(false, "a rotation with NaN is refused");
    } catch (const rhumb::Error& error) {
        expect(std::string(error.what()).find("rotation") != std::string::npos, error.what());
    }
    expect_error(RHUMB_CODE_CLOSED, "a connection joins once", [&] { connection.join("handles"); });
    auto moved = std::move(scene);
    expect_error(RHUMB_CODE_CLOSED, "a scene that was moved from", [&] { scene.advance(); });
    moved.advance();
    moved.close();
    moved.close();
    expect_error(RHUMB_CODE_CLOSED, "use after close", [&] { moved.advance(); });
    expect_error(RHUMB_CODE_CLOSED, "poses after close", [&] { moved.poses(); });
    expect_error(RHUMB_CODE_CLOSED, "place after close", [&] { moved.place(1); });
}

void shapes(rhumb::Scene& scene) {
    const auto floor = rhumb::Shape::heights(2, 10, 10, {0, 0, 0, 0});
    scene.add_body(rhumb::BodyDesc::fixed(floor).at(0, -2, 0));
    const auto ramp = rhumb::Shape::mesh({{0, 0, 0}, {1, 0, 0}, {0, 0, 1}}, {0, 1, 2});
    scene.add_body(rhumb::BodyDesc::fixed(ramp).at(20, 0, 0));
    // A temporary shape is copied by its body.
    const auto hull = rhumb::BodyDesc::dynamic(rhumb::Shape::hull({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}}));
    auto copy = hull;
    const auto bodies = scene.add_bodies({hull, copy.at(3, 0, 0), rhumb::BodyDesc::kinematic(rhumb::Shape::ball(1)).at(6, 0, 0)});
    scene.advance();
    expect(scene.poses().size() == 5, "five bodies were added");
    expect(scene.place(bodies[1]).has_value(), "a hull is in the view");
    expect_error(RHUMB_CODE_INVALID, "two corners", [] { rhumb::Shape::mesh({{0, 0, 0}}, {0, 0}); });
    expect_error(RHUMB_CODE_INVALID, "no corner there", [&] {
        scene.add_body(rhumb::BodyDesc::fixed(rhumb::Shape::mesh({{0, 0, 0}}, {0, 0, 1})));
    });
    expect_error(RHUMB_CODE_INVALID, "not a number", [&] {
        scene.add_body(rhumb::BodyDesc::dynamic(rhumb::Shape::ball(std::nanf(""))));
    });
    expect_error(RHUMB_CODE_INVALID, "a hull is not cast", [&] {
        scene.query({rhumb::query::overlap(rhumb::Shape::hull({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}}), {0, 0, 0})});
    });
}

void refusals(rhumb::Scene& scene) {
    const std::uint64_t before = scene.advance();
    const std::uint64_t number = scene.command(rhumb::command::wake(77));
    try {
        scene.advance();
        expect(false, "a refusal is an exception");
    } catch (const rhumb::RefusedError& error) {
        const auto& refusal = error.refusals().at(0);
        expect(error.code() == RHUMB_CODE_REFUSED && error.refusals().size() == 1, "one refusal");
        expect(refusal.number == number && refusal.body == 77, "of this command and body");
        expect(refusal.reason == "unknown body" && refusal.text == "the scene has no body 77", "with its reason");
    }
    expect(scene.poses().tick() == before + 1, "the tick is done");
    expect(scene.advance() == before + 2, "the next call continues");
}

void views(rhumb::Scene& scene) {
    const auto poses = scene.poses();
    bool refused = false;
    try {
        static_cast<void>(poses.positions()[poses.size()]);
    } catch (const std::out_of_range&) {
        refused = true;
    }
    expect(refused, "a place beyond the arrays is an exception");
    expect(!scene.place(0).has_value(), "no body has no place");
    const auto found = scene.query({rhumb::query::projection({6, 2, 0}, 100),
                                    rhumb::query::overlap(rhumb::Shape::ball(1.5), {6, 0, 0})});
    expect(found.hits.size() == 2, "one body is nearest, and the same one is there");
    bool placed = false;
    while (const auto event = scene.poll_event()) {
        placed = placed || event->kind == RHUMB_EVENT_KIND_BODY_PLACED;
    }
    expect(placed, "an event reports a body");
}

/// The error that a call throws, or none.
template <typename Call>
RhumbCode code_of(Call call) {
    try {
        call();
    } catch (const rhumb::Error& error) {
        return error.code();
    }
    return RHUMB_CODE_OK;
}

void two_threads(rhumb::Scene& scene) {
    RhumbCode seen = RHUMB_CODE_OK;
    while (seen == RHUMB_CODE_OK) {
        std::atomic<bool> is_over{false};
        std::thread other([&] {
            // This thread may be the one that is refused, while the other one looks whether it is inside.
            while (code_of([&] { scene.idle(0.5); }) == RHUMB_CODE_BUSY) {
            }
            is_over = true;
        });
        while (seen == RHUMB_CODE_OK && !is_over) {
            std::this_thread::yield();
            seen = code_of([&] { scene.flush(); });
        }
        other.join();
    }
    expect(seen == RHUMB_CODE_BUSY, "a second thread is refused");
    scene.advance();
}

}  // namespace

int main(int count, char** arguments) try {
    if (count != 3) {
        return 2;
    }
    const std::string address = arguments[1];
    const auto trust = rhumb::Trust::fingerprint(arguments[2]);
    expect_error(RHUMB_CODE_INVALID, "no fingerprint", [&] {
        rhumb::Connection::connect(address, rhumb::Trust::fingerprint(""));
    });
    expect_error(RHUMB_CODE_INVALID, "a wrong token", [&] {
        rhumb::Connection::connect(address, trust, "no\ntoken").join("token");
    });
    handles(rhumb::Connection::connect(address, trust));
    auto scene = rhumb::Connection::connect(address, trust).join("misuse");
    shapes(scene);
    views(scene);
    refusals(scene);
    two_threads(scene);
    scene.delete_scene();
    expect_error(RHUMB_CODE_SCENE_GONE, "a deleted scene", [&] { scene.advance(); });
    std::puts("every misuse was an exception");
    return 0;
} catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}
