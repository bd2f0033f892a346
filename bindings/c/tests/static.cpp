// Static objects of the C++ header close after main, and no error does harm.
//
// Arguments: the server's address and fingerprint.

#include <cstdio>
#include <exception>
#include <optional>
#include <utility>

#include "rhumb.hpp"

namespace {

std::optional<rhumb::Connection> used_up;
std::optional<rhumb::Scene> moved_from;

// The thread keeps the sentence of an error from now on. It gives the sentence up before static objects are destroyed.
bool catches_an_error(const char* address) {
    try {
        rhumb::Connection::connect(address, rhumb::Trust::fingerprint(""));
    } catch (const rhumb::Error& error) {
        return error.code() == RHUMB_CODE_INVALID;
    }
    return false;
}

}  // namespace

int main(int count, char** arguments) try {
    if (count != 3 || !catches_an_error(arguments[1])) {
        return 2;
    }
    used_up.emplace(rhumb::Connection::connect(arguments[1], rhumb::Trust::fingerprint(arguments[2])));
    moved_from.emplace(used_up->join("static"));
    rhumb::Scene scene = std::move(*moved_from);
    scene.advance();
    scene.close();
    std::puts("both objects are left to the end");
    return 0;
} catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
}
