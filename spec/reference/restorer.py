"""Lost packets out of parities, from PROTOCOL 5.16 and 6.15.

Knows numbers and bytes, not what they say. A column is a list of bytes; the shorter ones end in zeros.
"""

from packets import Bytes, factor, head_of, inverse, multiples, read_head, times

SPAN, KEPT = 32, 16


def plus_multiple(sums, multiple, column):
    """sums + multiple * column, for each byte."""
    longer = max(len(sums), len(column))
    sums, column = sums + bytes(longer - len(sums)), column + bytes(longer - len(column))
    return bytes(a ^ b for a, b in zip(sums, column.translate(multiples(multiple))))


def column_of(datagram):
    """The kind, and all behind the number."""
    frm = Bytes(datagram)
    kind, _ = read_head(frm)
    frm.raw(2)
    return bytes([kind]) + frm.rest()


def datagram_of(column, stream, number):
    # Sums of nothing give a column of nothing: no datagram, as its reader will say.
    column = column.rstrip(b"\0") or b"\0"
    return head_of(column[0], stream) + (number & 0xFFFF).to_bytes(2, "little") + column[1:]


class Restorer:
    """What a listener keeps so that parities give it lost packets back."""

    def __init__(self, stream):
        self.stream, self.columns, self.parities, self.unwanted_below, self.oldest = stream, {}, [], 0, 0

    def keep(self, number, datagram):
        self.columns[number] = column_of(datagram)
        self.advance(number)

    def advance(self, newest):
        """6.15-3: what is older than the last SPAN numbers goes."""
        self.oldest = max(self.oldest, newest + 1 - SPAN)
        self.columns = {number: column for number, column in self.columns.items() if number >= self.oldest}

    def hear(self, last, covered, row, sums, next_number):
        """A parity; `covered` are the bits below the last number."""
        numbers = [last] + [last - 1 - bit for bit in range(SPAN - 1) if covered >> bit & 1]
        if last >= next_number + SPAN or min(numbers) < 0 or last < self.unwanted_below:
            return
        self.advance(last)
        self.parities.append(({number: factor(row, number) for number in numbers}, sums))

    def was_wrong(self, next_number):
        """What was rebuilt is malformed: a parity was no sum of what was said."""
        self.parities, self.unwanted_below = [], next_number + SPAN

    def rebuilt(self):
        """A packet that the parities give back, as number and datagram, or None."""
        rows = [self.without_known(*parity) for parity in self.parities]
        rows = [row for row in rows if row[0] and min(row[0]) >= self.oldest]
        self.parities = rows[-KEPT:]
        for row in eliminated(self.parities):
            if len(row[0]) == 1:
                (number, multiple), sums = *row[0].items(), row[1]
                column = plus_multiple(b"", inverse(multiple), sums)
                return number, datagram_of(column, self.stream, number)
        return None

    def without_known(self, factors, sums):
        for number in [number for number in factors if number in self.columns]:
            sums = plus_multiple(sums, factors[number], self.columns[number])
        return {number: one for number, one in factors.items() if number not in self.columns}, sums


def eliminated(rows):
    """Rows that mean the same, each led by a number that no other has, as far as they go."""
    rows, done = [(dict(factors), sums) for factors, sums in rows], []
    while rows:
        factors, sums = rows.pop(0)
        if not factors:
            continue
        lead = min(factors)
        others = [(rows, place) for place in range(len(rows))] + [(done, place) for place in range(len(done))]
        for where, place in others:
            other, other_sums = where[place]
            if lead not in other:
                continue
            multiple = times(other[lead], inverse(factors[lead]))
            mixed = {number: other.get(number, 0) ^ times(multiple, factors.get(number, 0)) for number in other.keys() | factors.keys()}
            where[place] = ({number: one for number, one in mixed.items() if one}, plus_multiple(other_sums, multiple, sums))
        done.append((factors, sums))
    return done
