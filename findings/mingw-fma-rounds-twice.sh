#!/usr/bin/env bash
# fma(a, b, c) of C in a program for Windows, compiled by MinGW-w64: a*b + c with one rounding, says C99.
# Debian 12: gcc-mingw-w64-x86-64-win32 12.2.0-14+deb12u1+25.2+b1, mingw-w64-x86-64-dev 10.0.0-3; run by wine64 8.0.
# Guess: 0.1 * 0.3 + 1/60 is 0x1.7e4b17e4b17e5p-5, as exact arithmetic rounds it, and as fma of Linux gives.
# Seen: 0x1.7e4b17e4b17e4p-5, the same as with two roundings: MinGW's own library computes in 80 bits, and rounds again. The
# target x86_64-pc-windows-gnu of Rust has it too, in mul_add. Two peers that fuse on purpose part by a bit.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work" 2>/dev/null || { sleep 6; rm -rf "$work"; }' EXIT
cd "$work"
apt-get download -qq -o APT::Sandbox::User=root gcc-mingw-w64-x86-64-win32=12.2.0-14+deb12u1+25.2+b1 gcc-mingw-w64-x86-64-win32-runtime \
    gcc-mingw-w64-base binutils-mingw-w64-x86-64 mingw-w64-x86-64-dev=10.0.0-3 mingw-w64-common wine64 libwine libz-mingw-w64
for package in *.deb; do dpkg -x "$package" root; done
ls -- *.deb
# Wine's link to this library leads to an installed one.
cp --remove-destination root/usr/x86_64-w64-mingw32/lib/zlib1.dll root/usr/lib/x86_64-linux-gnu/wine/x86_64-windows/
cat >fma.c <<'C'
#include <math.h>
#include <stdio.h>
int main(void) {
    volatile double a = 0.1, b = 0.3, c = 1.0 / 60.0;
    printf("%a\n", fma(a, b, c));
    return 0;
}
C
root/usr/bin/x86_64-w64-mingw32-gcc-win32 -Broot/usr/x86_64-w64-mingw32/bin -O0 -o fma.exe fma.c
seen=$(WINEDEBUG=-all WINEPREFIX=$work/wine root/usr/lib/wine/wine64 fma.exe 2>/dev/null | tr -d '\r')
exact=$(python3 -c 'from fractions import Fraction as F; print(float(F(0.1) * F(0.3) + F(1 / 60)).hex())')
twice=$(python3 -c 'print((0.1 * 0.3 + 1 / 60).hex())')
echo "fma of MinGW $seen, exact $exact, two roundings $twice"
if [ "$seen" != "$twice" ] || [ "$seen" = "$exact" ]; then
    echo "changed: fma rounds once"
    exit 1
fi
echo "as found: fma of MinGW rounds twice"
