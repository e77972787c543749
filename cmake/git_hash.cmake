# Writes OUTPUT with the commit of SOURCE_DIR; touches the file only when the commit changed, so that a new commit
# compiles one small file again and nothing else. Run at every build: cmake -DSOURCE_DIR=.. -DOUTPUT=.. -P git_hash.cmake
cmake_minimum_required(VERSION 3.24)
set(hash "unknown")
find_program(GIT git)
if(GIT AND EXISTS "${SOURCE_DIR}/.git")
    execute_process(COMMAND "${GIT}" describe --always --abbrev=12 --dirty --exclude=*
        WORKING_DIRECTORY "${SOURCE_DIR}" OUTPUT_VARIABLE described ERROR_QUIET
        RESULT_VARIABLE status OUTPUT_STRIP_TRAILING_WHITESPACE)
    if(status EQUAL 0)
        set(hash "${described}")
    endif()
endif()
file(CONFIGURE OUTPUT "${OUTPUT}" CONTENT "#define VDB_NNS_GIT_HASH \"@hash@\"\n" @ONLY)
