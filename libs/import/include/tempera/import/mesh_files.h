// SPDX-License-Identifier: Apache-2.0
#pragma once
// Readers of single mesh files from memory: Wavefront OBJ, Stanford PLY and Mitsuba's serialized meshes, and the
// shading normals that such files often lack. What a file does not hold stays empty in the Mesh.
#include <cstdint>
#include <string>
#include <string_view>

#include "tempera/core/log.h"
#include "tempera/scene/geometry.h"

namespace tempera {

/// All faces of a Wavefront OBJ file as one mesh; polygons become triangles (fans around their first vertex if they are
/// convex; concave ones are covered exactly; those that cross themselves overlap, with a note in `warnings`). One
/// vertex for each distinct triple of position, texture coordinate and normal, in the order of first use. Normals are
/// unit or, where the file gives none for a vertex while it does for others, zero. v of texture coordinates as stored
/// (0 at the bottom). A backslash at the end of a line continues it. Groups, materials, lines, points and curves are
/// skipped. Errors: Error{kBadInput} at the line in `file` for numbers that cannot be read, that are not finite, or
/// indices out of range. Memory: a small multiple of the text's size. Threads: re-entrant, uses parallel loops.
Mesh read_obj(std::string_view text, const std::string& file, Warnings& warnings);

/// A PLY file, ascii or binary of either byte order. Reads x y z, nx ny nz, u v (or s t, texture_u texture_v), colors
/// (r g b, red green blue, color_r …; alpha too) of vertices or else of faces, and vertex_index lists. Integer colors
/// are scaled from their range to [0,1]. Polygons as in `read_obj`. Other properties and elements are skipped with a
/// note in `warnings`. Errors: Error{kBadInput} at the line of the header or of ascii data, Error{kUnsupported} for
/// another PLY version.
Mesh read_ply(std::string_view bytes, const std::string& file, Warnings& warnings);

/// Mesh number `shape_index` (from 0) of a Mitsuba serialized file, format version 3 or 4, single or double precision.
/// `max_bytes` bounds the size of the unpacked mesh, which a damaged or hostile file can make large; 0: no bound.
/// Errors: Error{kBadInput} for damaged data, Error{kOutOfRange} for an index that the file does not have,
/// Error{kUnsupported} for another version, Error{kOutOfMemory} beyond `max_bytes`; all at `file`.
Mesh read_serialized(std::string_view bytes, const std::string& file, int shape_index, std::uint64_t max_bytes = 0);

/// Gives each vertex the mean of its triangles' unit normals weighted by their angles [Thürmer 1998], in the direction
/// that the winding gives. Only vertices whose normal is zero are changed; an empty array counts as all zero. Vertices
/// without a proper triangle get (1,0,0), as in Mitsuba.
void fill_normals(Mesh& mesh);

/// Smooth normals that break at edges: triangles contribute to each other's corner normals where they share a position
/// and their normals differ by at most `max_angle` radians. Duplicates vertices as needed; replaces all normals.
void crease_normals(Mesh& mesh, float max_angle);

/// Turns triangles over whose winding contradicts their vertex normals, so that both name the same front side.
void align_winding(Mesh& mesh);

}  // namespace tempera
