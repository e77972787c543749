# Finds libdeflate by its header and library: Debian 12 ships no package configuration of it. It is installed with this project,
# for consumers.
#
# Target:    Libdeflate::Libdeflate
# Variables: Libdeflate_FOUND
# Hint:      Libdeflate_ROOT

find_path(Libdeflate_INCLUDE_DIR libdeflate.h)
find_library(Libdeflate_LIBRARY deflate)
mark_as_advanced(Libdeflate_INCLUDE_DIR Libdeflate_LIBRARY)

include(FindPackageHandleStandardArgs)
find_package_handle_standard_args(Libdeflate REQUIRED_VARS Libdeflate_LIBRARY Libdeflate_INCLUDE_DIR)

if(Libdeflate_FOUND AND NOT TARGET Libdeflate::Libdeflate)
    add_library(Libdeflate::Libdeflate UNKNOWN IMPORTED)
    set_target_properties(Libdeflate::Libdeflate PROPERTIES IMPORTED_LOCATION "${Libdeflate_LIBRARY}")
    target_include_directories(Libdeflate::Libdeflate INTERFACE "${Libdeflate_INCLUDE_DIR}")
endif()
