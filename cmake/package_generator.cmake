# Read by cpack once for each generator: a .deb is the plain install, not the portable component.
if(CPACK_GENERATOR STREQUAL "DEB")
    list(GET CPACK_INSTALL_CMAKE_PROJECTS 0 build)
    list(GET CPACK_INSTALL_CMAKE_PROJECTS 1 name)
    set(CPACK_INSTALL_CMAKE_PROJECTS "${build};${name};ALL;/;${build};${name};deb;/")
    set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
    unset(CPACK_PACKAGE_CHECKSUM)
endif()
