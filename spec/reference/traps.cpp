//! Evaluates the formulas of the traps (RECKONING 6), as a compiler has compiled them: check_traps.py compares.
//!
//! Reads a line for each case: a formula without blanks, and its operands as digits. Writes the digits of each result.

#include <cmath>
#include <cstdint>
#include <cstring>
#include <iostream>
#include <sstream>
#include <string>

static double of(const std::string &digits) {
    std::uint64_t bits = std::stoull(digits, nullptr, 16);
    double value;
    std::memcpy(&value, &bits, sizeof value);
    return value;
}

static double evaluated(const std::string &formula, double a, double b, double c, double d) {
    if (formula == "a*b+c") return a * b + c;
    if (formula == "a*a+b*b+c*c") return a * a + b * b + c * c;
    if (formula == "a*b-c*d") return a * b - c * d;
    if (formula == "a/b") return a / b;
    if (formula == "a+b+c") return a + b + c;
    if (formula == "a+b") return a + b;
    if (formula == "a*b") return a * b;
    if (formula == "sqrt(a)") return std::sqrt(a);
    if (formula == "-a") return -a;
    return std::floor(a + 0.5);
}

int main() {
    std::string line;
    while (std::getline(std::cin, line)) {
        std::istringstream words(line);
        std::string formula, digits;
        double operands[4] = {};
        words >> formula;
        for (double &operand : operands) {
            if (words >> digits) operand = of(digits);
        }
        double result = evaluated(formula, operands[0], operands[1], operands[2], operands[3]);
        std::uint64_t bits;
        std::memcpy(&bits, &result, sizeof bits);
        std::cout << std::hex << bits << "\n";
    }
}
