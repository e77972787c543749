# What the documents quote is true to the letter: the flag tables of docs/cli.md are what the program prints, and the example of
# README.md is the compiled sample.

# section(file begin end out): the text of a document between two markers.
function(section file begin end out)
    file(READ "${SOURCE_DIR}/${file}" document)
    string(FIND "${document}" "${begin}" first)
    string(FIND "${document}" "${end}" last)
    if(first EQUAL -1 OR last EQUAL -1)
        message(FATAL_ERROR "${file} has no '${begin}' .. '${end}'")
    endif()
    string(LENGTH "${begin}" length)
    math(EXPR first "${first} + ${length}")
    math(EXPR length "${last} - ${first}")
    string(SUBSTRING "${document}" ${first} ${length} text)
    string(STRIP "${text}" text)
    set(${out} "${text}" PARENT_SCOPE)
endfunction()

execute_process(COMMAND "${CLI}" --help-markdown OUTPUT_VARIABLE printed COMMAND_ERROR_IS_FATAL ANY)
string(STRIP "${printed}" printed)
section(docs/cli.md "<!-- vdb_nns --help-markdown -->" "<!-- end of --help-markdown -->" table)
if(NOT table STREQUAL printed)
    file(WRITE "${WORK_DIR}/help.md" "${printed}\n")
    message(SEND_ERROR "docs/cli.md does not show what `vdb_nns --help-markdown` prints; run tools/readme.sh")
endif()

file(READ "${SOURCE_DIR}/samples/readme_example.cpp" sample)
string(STRIP "${sample}" sample)
section(README.md "<!-- samples/readme_example.cpp -->\n```cpp" "```\n<!-- end of the example -->" example)
if(NOT example STREQUAL sample)
    message(SEND_ERROR "README.md does not show samples/readme_example.cpp; run tools/readme.sh")
endif()
