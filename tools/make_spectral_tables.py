#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Writes libs/shading/src/spectral_tables.cpp: the CIE 1931 observer, the illuminant D65 and the RGB indices of refraction
of named conductors, read from the Mitsuba 3 wheel (tools/requirements-dev.txt).

  python3 tools/make_spectral_tables.py > libs/shading/src/spectral_tables.cpp
"""
import glob
import os

import mitsuba as mi

mi.set_variant("scalar_rgb")
mi.set_log_level(mi.LogLevel.Error)  # its messages go to standard output

D65_SCALE = 98.99741751876255  # Mitsuba normalises D65 by this; the CIE's table is 100 at 560 nm


def number(v):
    text = f"{v:.7g}"
    return (text if any(c in text for c in ".e") else text + ".0") + "f"


def rows(values, per_row=8):
    for i in range(0, len(values), per_row):
        print("    " + ", ".join(values[i:i + per_row]) + ",")


def main():
    wavelengths = range(360, 831, 5)
    print("// SPDX-License-Identifier: Apache-2.0")
    print(f"// Written by tools/make_spectral_tables.py with Mitsuba {mi.__version__}; do not edit. The observer and D65 are the")
    print("// CIE's tables. The conductors are measurements collected in Palik's Handbook of Optical Constants and by CXRO/LLNL,")
    print("// integrated to linear RGB as Mitsuba's rgb variants do.")
    print("// clang-format off")
    print('#include "spectral_tables.h"\n\nnamespace tempera {\n')
    print("const std::array<CieSample, kCieSamples> kCieObserver{{")
    rows(["{%s, %s, %s}" % tuple(number(float(c)) for c in mi.cie1931_xyz(float(w))) for w in wavelengths], 3)
    print("}};\n\nconst std::array<float, kCieSamples> kCieD65{")
    rows([number(round(float(mi.cie_d65(float(w))) * D65_SCALE, 4)) for w in wavelengths], 8)
    print("};\n")
    folder = os.path.dirname(mi.__file__)
    names = sorted(os.path.basename(f)[:-len(".eta.spd")] for f in glob.glob(folder + "/**/*.eta.spd", recursive=True))
    print(f"const std::array<ConductorEntry, {len(names)}> kConductors{{{{")
    for name in names:
        params = mi.traverse(mi.load_dict({"type": "conductor", "material": name}))
        eta = ", ".join(number(float(c)) for c in params["eta.value"])
        k = ", ".join(number(float(c)) for c in params["k.value"])
        print(f'    {{"{name}", {{{eta}}}, {{{k}}}}},')
    print("}};\n\n}  // namespace tempera")


if __name__ == "__main__":
    main()
