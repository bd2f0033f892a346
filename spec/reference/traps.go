// Evaluates the formulas of the traps (RECKONING 6), as a compiler has compiled them: check_traps.py compares.
//
// Reads a line for each case: a formula without blanks, and its operands as digits. Writes the digits of each result.
package main

import (
	"bufio"
	"fmt"
	"math"
	"os"
	"strconv"
	"strings"
)

func evaluated(formula string, a, b, c, d float64) float64 {
	switch formula {
	case "a*b+c":
		return a*b + c
	case "a*a+b*b+c*c":
		return a*a + b*b + c*c
	case "a*b-c*d":
		return a*b - c*d
	case "a/b":
		return a / b
	case "a+b+c":
		return a + b + c
	case "a+b":
		return a + b
	case "a*b":
		return a * b
	case "sqrt(a)":
		return math.Sqrt(a)
	case "-a":
		return -a
	}
	return math.Floor(a + 0.5)
}

func main() {
	lines := bufio.NewScanner(os.Stdin)
	for lines.Scan() {
		words := strings.Fields(lines.Text())
		var operands [4]float64
		for place, digits := range words[1:] {
			bits, _ := strconv.ParseUint(digits, 16, 64)
			operands[place] = math.Float64frombits(bits)
		}
		result := evaluated(words[0], operands[0], operands[1], operands[2], operands[3])
		fmt.Printf("%x\n", math.Float64bits(result))
	}
}
