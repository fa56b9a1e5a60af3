# Finds OpenImageIO for the including directory. Debian's package asks for the headers of OpenCV, which its own headers
# use only in a file that we do not include; without OpenCV installed that path does not exist, and CMake refuses it.
find_package(OpenImageIO REQUIRED)
get_target_property(openimageio_includes OpenImageIO::OpenImageIO INTERFACE_INCLUDE_DIRECTORIES)
set(openimageio_existing "")
foreach(directory IN LISTS openimageio_includes)
  if(EXISTS "${directory}")
    list(APPEND openimageio_existing "${directory}")
  endif()
endforeach()
set_target_properties(OpenImageIO::OpenImageIO PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${openimageio_existing}")
