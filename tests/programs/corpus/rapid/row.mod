MODULE Row
  CONST robtarget pRow{4}:=[<9|gripper|table>,<10|gripper|table>,
    <11|gripper|table>,   ! third
    <12|gripper|table>];
  CONST num nAbove:=60;
  PROC Run()
    VAR num i;
    FOR i FROM 1 TO Dim(pRow,1) DO
      MoveJ Offs(pRow{i},0,0,nAbove),v1000,z10,gripper\WObj:=table;
      MoveL pRow{i},v100,fine,gripper\WObj:=table;
      MoveL Offs(pRow{i},0,0,nAbove+10*2),v1000,z10,gripper\WObj:=table;
    ENDFOR
  ENDPROC
ENDMODULE
