// SPDX-License-Identifier: Apache-2.0
#pragma once
// Runtime errors: what went wrong with files, configuration or devices, where, and what would be right. Thrown by
// libraries, caught only by programs, which map the code to the exit status. Not for logic errors (assert) and not for
// expected misses (std::optional).
#include <cassert>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

#ifdef TEMPERA_ASSERTS
#define TEMPERA_ASSERT(x) ((x) ? void(0) : ::tempera::assertion_failed(#x, __FILE__, __LINE__))
#else
#define TEMPERA_ASSERT(x) void(0)
#endif

namespace tempera {

[[noreturn]] void assertion_failed(const char* what, const char* file, int line);

/// A place in an input file. Lines and columns count from 1; 0 means unknown. `file` may be "<command line>".
struct SourceLoc {
  std::string file;
  int line = 0;
  int column = 0;
  /// "file:line:column", without the parts that are unknown.
  std::string str() const;
};

enum class ErrorCode {
  kFailed,       ///< failed while running (disk full, device lost)
  kUsage,        ///< bad command line
  kSyntax,       ///< input that cannot be parsed
  kBadInput,     ///< parsed, but invalid: wrong type, broken reference, inconsistent sizes
  kUnknownName,  ///< a key, name or value that does not exist
  kOutOfRange,   ///< a value outside its valid range
  kUnsupported,  ///< valid input that this program cannot do (a warning unless --strict)
  kMissingFile,  ///< a file that cannot be opened for reading
  kOutOfMemory,  ///< a memory limit was reached
  kCancelled,    ///< stopped on request
  kDiffers,      ///< a comparison passed its threshold
};

/// "usage", "missing_file", ...: for programs.
std::string_view to_string(ErrorCode code);

/// Process exit status of an error: 1 failed, 2 usage, 3 bad scene or input, 4 missing file, 5 out of memory,
/// 6 comparison differs, 130 interrupted.
int exit_status(ErrorCode code);

class Error : public std::runtime_error {
 public:
  Error(ErrorCode code, SourceLoc loc, std::string message);
  Error(ErrorCode code, std::string message) : Error(code, SourceLoc{}, std::move(message)) {}
  ErrorCode code() const { return code_; }
  const SourceLoc& loc() const { return loc_; }
  /// The sentence without the place; what() has both as "file:line:column: message".
  const std::string& message() const { return message_; }

 private:
  ErrorCode code_;
  SourceLoc loc_;
  std::string message_;
};

/// "message" preceded by its place and followed by the source line with a caret, if the file can be read.
std::string format_with_excerpt(const Error& error);

/// Line and column (from 1) of byte `offset` in `text`.
SourceLoc locate(const std::string& file, std::string_view text, std::size_t offset);

/// `names` ordered by edit distance to `wanted`, joined by ", ", at most `limit` of them: for "known: ..." in messages.
std::string nearest_names(std::string_view wanted, std::vector<std::string> names, std::size_t limit = 8);

}  // namespace tempera
