MODULE Nested
  RECORD side
    robtarget near;
    robtarget far;
  ENDRECORD
  RECORD cell
    side left;
    side right;
    num count;
  ENDRECORD
  PERS cell c1:=[[<32|gripper|table>,<33|gripper|table>],[<34|gripper|table>,<35|gripper|table>],12];
  PROC visit()
    MoveJ c1.left.near,v1000,z50,gripper\WObj:=table;
    MoveL c1.left.far,v100,fine,gripper\WObj:=table;
    MoveJ c1.right.near,v1000,z50,gripper\WObj:=table;
    MoveL c1.right.far,v100,fine,gripper\WObj:=table;
  ENDPROC
ENDMODULE
