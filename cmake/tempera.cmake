# Warnings, optimisation and the one-line module definition.
add_library(tempera_options INTERFACE)
target_compile_options(tempera_options INTERFACE -Wall -Wextra -Wshadow -Wnon-virtual-dtor -Wno-psabi
  -Wconversion -Wno-sign-conversion  # nothing is narrowed silently; an int may index
  -Wno-missing-field-initializers)  # designated initializers name what differs from the defaults
if(TEMPERA_ARCH)
  include(CheckCXXCompilerFlag)
  check_cxx_compiler_flag("-march=${TEMPERA_ARCH}" TEMPERA_HAS_ARCH)
  if(TEMPERA_HAS_ARCH)
    target_compile_options(tempera_options INTERFACE -march=${TEMPERA_ARCH})
  endif()
endif()
# Value-safe speed only: results stay IEEE (no -ffast-math), errno and trapping are not used.
target_compile_options(tempera_options INTERFACE -fno-math-errno -fno-trapping-math)
if(TEMPERA_SANITIZE)
  target_compile_options(tempera_options INTERFACE -fsanitize=${TEMPERA_SANITIZE} -fno-omit-frame-pointer -g)
  target_link_options(tempera_options INTERFACE -fsanitize=${TEMPERA_SANITIZE})
endif()
target_compile_definitions(tempera_options INTERFACE TEMPERA_VERSION="${PROJECT_VERSION}"
  $<$<OR:$<CONFIG:Debug>,$<BOOL:${TEMPERA_ASSERTS}>>:TEMPERA_ASSERTS>)

# tempera_module(NAME [DEPENDS modules...] [USES private targets...] [PUBLIC_USES targets...])
# A module is libs/NAME: headers for others in include/tempera/NAME (a verified file set), sources in src or folders of
# their own, tests as *_test.cpp in folders named tests.
function(tempera_module name)
  cmake_parse_arguments(M "" "" "DEPENDS;USES;PUBLIC_USES" ${ARGN})
  file(GLOB_RECURSE sources CONFIGURE_DEPENDS *.cpp)
  set(tests ${sources})
  list(FILTER sources EXCLUDE REGEX "/libs/${name}/(.*/)?tests/")
  list(FILTER tests INCLUDE REGEX "/libs/${name}/(.*/)?tests/.*_test\\.cpp$")
  file(GLOB headers CONFIGURE_DEPENDS include/tempera/${name}/*.h)
  add_library(tempera_${name} STATIC ${sources})
  add_library(tempera::${name} ALIAS tempera_${name})
  target_sources(tempera_${name} PUBLIC FILE_SET HEADERS BASE_DIRS include FILES ${headers})
  set_target_properties(tempera_${name} PROPERTIES VERIFY_INTERFACE_HEADER_SETS ON)
  target_include_directories(tempera_${name} PRIVATE src .)
  if(NOT TEMPERA_PATH_SPACE_MOTION)
    list(REMOVE_ITEM M_DEPENDS chain_motion)
  endif()
  list(TRANSFORM M_DEPENDS PREPEND tempera::)
  target_link_libraries(tempera_${name} PUBLIC tempera_options ${M_DEPENDS} ${M_PUBLIC_USES} PRIVATE ${M_USES})
  if(TEMPERA_TESTS AND tests)
    tempera_test(${name}_test SOURCES ${tests} LINKS tempera::${name} ${M_USES} LABELS fast)
    target_include_directories(${name}_test PRIVATE src tests .)
  endif()
endfunction()

# tempera_test(NAME SOURCES files LINKS targets LABELS fast|slow|...): one GoogleTest program, registered with CTest. It may
# include what tests share as "support/...".
function(tempera_test name)
  cmake_parse_arguments(T "" "" "SOURCES;LINKS;LABELS" ${ARGN})
  add_executable(${name} ${T_SOURCES})
  target_link_libraries(${name} PRIVATE ${T_LINKS} tempera_options GTest::gtest GTest::gtest_main)
  target_include_directories(${name} PRIVATE ${PROJECT_SOURCE_DIR}/tests)
  target_compile_definitions(${name} PRIVATE TEMPERA_SOURCE_DIR="${PROJECT_SOURCE_DIR}")
  add_test(NAME ${name} COMMAND ${name})
  set_tests_properties(${name} PROPERTIES LABELS "${T_LABELS}" TIMEOUT 1800)
endfunction()
