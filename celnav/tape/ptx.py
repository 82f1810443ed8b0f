"""Kernels as PTX, the assembly language of NVIDIA devices: each thread computes one run through all
epochs.

A step is the function that `celnav.tape.llvm` writes, for one run, inside a loop over the epochs,
which all threads execute together. Neighboring threads read and write neighboring numbers::

    state   (S, runs)                what a run carries from step to step, in registers meanwhile
    shared  (steps, E)               inputs that all runs have in common
    own     (steps, M, runs)         inputs of each run
    rows    (rows stored, runs, n)   the stored results of a step, one field after the other
"""

from __future__ import annotations

from collections.abc import Sequence

from celnav.tape import llvm
from celnav.tape.kernel import Kernel, digest

TARGET, TRIPLE = (7, 0), "nvptx64-nvidia-cuda"
"""Lowest compute capability supported; the driver compiles for the present device."""
_ARGUMENTS = (
    "ptr %kinds, ptr %at, ptr %state, ptr %shared, ptr %own, ptr %rows, "
    "i64 %E, i64 %M, i64 %K, i64 %runs, i64 %steps"
)
_FLY = """
define void @fly(@ARGUMENTS, i64 %run)
{
start:
  %s = alloca [@SIZE x double]
  %c = alloca [@CELLS x double]
@LOAD
  %M_runs = mul i64 %M, %runs
  %f = alloca [@COUNT x ptr]
  %K_runs = mul i64 %K, %runs
@FIELDS
  br label %epoch
epoch:
  %k = phi i64 [0, %start], [%k1, %stepped]
  %kp = getelementptr i32, ptr %kinds, i64 %k
  %kind = load i32, ptr %kp
  %e0 = mul i64 %k, %E
  %e = getelementptr double, ptr %shared, i64 %e0
  %m0 = mul i64 %k, %M_runs
  %m1 = add i64 %m0, %run
  %m = getelementptr double, ptr %own, i64 %m1
  %rp = getelementptr i64, ptr %at, i64 %k
  %row = load i64, ptr %rp
  %o0 = mul i64 %row, %runs
  %o1 = add i64 %o0, %run
  switch i32 %kind, label %stepped [@CASES]
@STEPS
stepped:
  %k1 = add i64 %k, 1
  %more = icmp slt i64 %k1, %steps
  br i1 %more, label %epoch, label %done
done:
@STORE
  ret void
}
"""
_LOAD = """  %i# = mul i64 %runs, #
  %j# = add i64 %i#, %run
  %from# = getelementptr double, ptr %state, i64 %j#
  %to# = getelementptr double, ptr %s, i64 #
  %x# = load double, ptr %from#
  store double %x#, ptr %to#"""
_STORE = """  %y# = load double, ptr %to#
  store double %y#, ptr %from#"""
_FIELD = """  %b# = mul i64 %K_runs, @BEFORE
  %c# = getelementptr double, ptr %rows, i64 %b#
  %d# = getelementptr ptr, ptr %f, i64 #
  store ptr %c#, ptr %d#"""
_CASE = "i32 #, label %kind#"
_STEP = """kind#:
  call void @step#(ptr %s, ptr %e, ptr %m, ptr %f, i64 %runs, ptr %c, i64 %o1)
  br label %stepped"""
_ENTRY = """
declare i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.tid.x()
define ptx_kernel void @entry(@ARGUMENTS)
{
  %block = call i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
  %width = call i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
  %thread = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()
  %before = mul i32 %block, %width
  %number = add i32 %before, %thread
  %run = zext i32 %number to i64
  %there = icmp slt i64 %run, %runs
  br i1 %there, label %go, label %done
go:
  call void @fly(@ARGUMENTS, i64 %run)
  br label %done
done:
  ret void
}
"""


def program(kernels: Sequence[Kernel], size: int) -> str:
    """PTX of the entry ``entry(kinds, at, state, shared, own, rows, E, M, K, runs, steps)``; equal
    programs are assembled once.

    kernels: ``kinds`` is the kernel of each epoch, and ``at`` the row that it stores, -1 for none.
        size: S.
    """
    key = tuple(digest(kernel) for kernel in kernels), size
    if key not in _PROGRAMS:
        _PROGRAMS[key] = assembled(source(kernels, size))
    return _PROGRAMS[key]


_PROGRAMS: dict[tuple[tuple[bytes, ...], int], str] = {}


def source(kernels: Sequence[Kernel], size: int) -> str:
    """LLVM assembly of a program; the steps are inlined in the loop, so that the state needs only
    registers.
    """
    binding, text = llvm.toolchain(), _FLY + _ENTRY
    # Templates, each with its number of copies; # becomes the index of the copy.
    parts = {
        "@ARGUMENTS": (_ARGUMENTS, 1),
        "@SIZE": (str(size), 1),
        "@LOAD": (_LOAD, size),
        "@STORE": (_STORE, size),
    }
    fields = kernels[0].fields or (len(kernels[0].rows),)
    where = [
        _FIELD.replace("@BEFORE", str(sum(fields[:i]))).replace("#", str(i))
        for i in range(len(fields))
    ]
    parts |= {"@CELLS": (str(max(kernel.cells for kernel in kernels)), 1)}
    parts |= {"@COUNT": (str(len(fields)), 1), "@FIELDS": ("\n".join(where), 1)}
    parts |= {name: (piece, len(kernels)) for name, piece in (("@CASES", _CASE), ("@STEPS", _STEP))}
    for name, (piece, count) in parts.items():
        text = text.replace(name, "\n".join(piece.replace("#", str(i)) for i in range(count)))
    declared = (
        f"declare void @step{i}(ptr noalias, ptr, ptr, ptr, i64, ptr noalias, i64)"
        for i in range(len(kernels))
    )
    module = binding.parse_assembly("\n".join([*declared, text]))
    for i, kernel in enumerate(kernels):
        # Each step is compiled as a module and linked under its own name.
        step_module = binding.parse_assembly(llvm.source(kernel, 1, True))
        step_module.get_function("step").name = f"step{i}"
        module.link_in(step_module)
    for function in module.functions:
        if not function.is_declaration and function.name != "entry":
            function.linkage = "internal"
    # Everything is inlined into the entry, so that the state remains in registers.
    for name in ("fly", *(f"step{i}" for i in range(len(kernels)))):
        module.get_function(name).add_function_attribute("alwaysinline")
    module.verify()
    return str(module)


def assembled(text: str) -> str:
    """PTX from LLVM assembly."""
    binding = llvm.toolchain()
    binding.initialize_all_targets()
    binding.initialize_all_asmprinters()
    module = binding.parse_assembly(text)
    machine = binding.Target.from_triple(TRIPLE).create_target_machine(
        cpu=f"sm_{TARGET[0]}{TARGET[1]}", opt=1
    )
    module.triple, module.data_layout = TRIPLE, str(machine.target_data)
    passes = binding.create_new_module_pass_manager()
    passes.add_always_inliner_pass()
    passes.run(
        module, binding.create_pass_builder(machine, binding.create_pipeline_tuning_options())
    )
    return str(machine.emit_assembly(module))
