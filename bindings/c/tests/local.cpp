// A server in the process, in C++.
//
// Its members see each other's bodies, and stay when its handle is gone.

#include <cstdio>
#include <cstdlib>
#include <utility>

#include "rhumb.hpp"

static void expect(bool holds, const char* what) {
    if (!holds) {
        std::fprintf(stderr, "does not hold: %s\n", what);
        std::exit(1);
    }
}

int main() {
    for (auto thread : {rhumb::LocalThread::Callers, rhumb::LocalThread::Own}) {
        rhumb::LocalServer server(thread);
        rhumb::LocalServer moved(std::move(server));
        auto one = moved.connect().join("shared");
        auto other = moved.connect(30).join("shared");
        auto ball = one.add_body(rhumb::BodyDesc::dynamic(rhumb::Shape::ball(0.5)).at(0, 10, 0));
        moved.close();
        moved.close();
        one.advance();
        for (int i = 0; i < 10 && !other.place(ball); ++i) other.advance();
        expect(other.place(ball).has_value(), "the other member sees the ball");
        try {
            moved.connect();
            expect(false, "a closed server refuses");
        } catch (const rhumb::Error& error) {
            expect(error.code() == RHUMB_CODE_CLOSED, error.what());
        }
    }
    auto connection = rhumb::Connection::local();
    expect(connection.join("drop").advance() == 1, "a scene on a server of its own");
    std::printf("the members saw the ball\n");
}
