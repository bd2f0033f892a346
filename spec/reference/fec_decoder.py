"""Restores lost packets from repair symbols (PROTOCOL 5.16, 6.15).

It handles numbers and bytes, not their meaning. A symbol is a list of bytes; shorter ones are padded with zeros.
"""

from packets import Bytes, factor, head_of, inverse, multiples, read_head, times

SPAN, KEPT = 32, 16


def add_multiple(mixed_symbol, multiple, symbol):
    """mixed_symbol + multiple * symbol, byte by byte."""
    longer = max(len(mixed_symbol), len(symbol))
    mixed_symbol, symbol = mixed_symbol + bytes(longer - len(mixed_symbol)), symbol + bytes(longer - len(symbol))
    return bytes(a ^ b for a, b in zip(mixed_symbol, symbol.translate(multiples(multiple))))


def symbol_of(datagram):
    """The source symbol: the kind, and all bytes after the number."""
    frm = Bytes(datagram)
    kind, _ = read_head(frm)
    frm.raw(2)
    return bytes([kind]) + frm.rest()


def datagram_of(symbol, stream, number):
    # A symbol of zeros only is not a datagram; its decoder will refuse it.
    symbol = symbol.rstrip(b"\0") or b"\0"
    return head_of(symbol[0], stream) + (number & 0xFFFF).to_bytes(2, "little") + symbol[1:]


class Decoder:
    """The packets and repair symbols that a subscriber keeps for the restoration of lost packets."""

    def __init__(self, stream, next_number):
        self.stream, self.symbols, self.repair_symbols = stream, {}, []
        # One more than the last number (6.15-3); the first number of which a repair symbol may lack packets (6.15-7).
        self.end = self.usable_from = next_number

    def keep(self, number, datagram):
        self.symbols[number] = symbol_of(datagram)
        self.advance(number)

    def advance(self, newest):
        """6.15-3: forgets everything older than the last SPAN numbers."""
        self.end = max(self.end, newest + 1)
        self.symbols = {number: symbol for number, symbol in self.symbols.items() if number >= self.end - SPAN}
        self.repair_symbols = [kept for kept in self.repair_symbols if self.is_of_use(kept)]

    def receive(self, last, covered, row, mixed_symbol, next_number):
        """Receives a repair symbol; `covered` has the bits of the numbers before the last."""
        numbers = [last] + [last - 1 - bit for bit in range(SPAN - 1) if covered >> bit & 1]
        if last >= next_number + SPAN:
            return
        self.advance(last)
        lacking = self.without_known({number: factor(row, number) for number in numbers}, mixed_symbol)
        # Of one row, equal factors are those of equal packets.
        if self.is_of_use(lacking) and all(kept[0] != lacking[0] for kept in self.repair_symbols):
            self.repair_symbols = [*self.repair_symbols, lacking][-KEPT:]

    def is_of_use(self, repair_symbol):
        """6.15-3, 6.15-7"""
        return repair_symbol[0] and min(repair_symbol[0]) >= max(self.end - SPAN, self.usable_from)

    def was_wrong(self):
        """6.15-6: a rebuilt packet is malformed, so a repair symbol was wrong: drops all of them."""
        self.repair_symbols, self.usable_from = [], self.end

    def requested(self, missing, next_number):
        """6.15-8, 6.15-10: how many further repair symbols rebuild the missing packets; 0 to have all refreshed."""
        oldest = max(next_number - SPAN, self.usable_from)
        lacking = [number for number in range(oldest, next_number) if number not in self.symbols]
        lost = [number for number in missing if number in lacking]
        if not lost or len(lacking) > KEPT:
            return 0
        covered = [number for number in lacking if number >= lost[0]]
        # Other packets are eliminated first: the rows left are those of the covered packets alone.
        rows = [({(number in covered, number): one for number, one in factors.items()}, b"") for factors, _ in self.repair_symbols]
        known = sum(all(of_covered for of_covered, _ in factors) for factors, _ in eliminated(rows))
        count = len(covered) - known
        return count if count <= len(lost) else 0

    def rebuilt(self):
        """The least restored packet as number and datagram, or None."""
        rows = [self.without_known(*repair_symbol) for repair_symbol in self.repair_symbols]
        self.repair_symbols = [row for row in rows if self.is_of_use(row)]
        restored = [row for row in eliminated(self.repair_symbols) if len(row[0]) == 1]
        if not restored:
            return None
        factors, mixed_symbol = min(restored, key=lambda row: min(row[0]))
        (number, multiple), = factors.items()
        symbol = add_multiple(b"", inverse(multiple), mixed_symbol)
        return number, datagram_of(symbol, self.stream, number)

    def without_known(self, factors, mixed_symbol):
        for number in [number for number in factors if number in self.symbols]:
            mixed_symbol = add_multiple(mixed_symbol, factors[number], self.symbols[number])
        return {number: one for number, one in factors.items() if number not in self.symbols}, mixed_symbol


def eliminated(rows):
    """Equivalent rows after Gaussian elimination: each has a pivot number that no other row has."""
    rows, done = [(dict(factors), mixed_symbol) for factors, mixed_symbol in rows], []
    while rows:
        factors, mixed_symbol = rows.pop(0)
        if not factors:
            continue
        lead = min(factors)
        others = [(rows, place) for place in range(len(rows))] + [(done, place) for place in range(len(done))]
        for where, place in others:
            other, other_symbol = where[place]
            if lead not in other:
                continue
            multiple = times(other[lead], inverse(factors[lead]))
            mixed = {number: other.get(number, 0) ^ times(multiple, factors.get(number, 0)) for number in other.keys() | factors.keys()}
            where[place] = ({number: one for number, one in mixed.items() if one}, add_multiple(other_symbol, multiple, mixed_symbol))
        done.append((factors, mixed_symbol))
    return done
